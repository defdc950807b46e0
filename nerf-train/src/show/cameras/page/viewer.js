
const body = document.body;
const element = id => document.getElementById(id);
let errors = 0;
const failed = event => {
  errors += 1;
  body.dataset.errors = errors;
  body.dataset.error = String(event.message || event.reason || event.violatedDirective || 'error').slice(0, 200);
};
for (const kind of ['error', 'unhandledrejection', 'securitypolicyviolation']) addEventListener(kind, failed);

const data = JSON.parse(element('data').textContent);
const canvas = element('canvas');
const context = canvas.getContext('2d', { alpha: false });
const view = new View(data.up, data.across);
const pictures = data.cameras.map(() => null);
/** Index of the camera that is shown alone, or null. */
let only = data.alone ? 0 : null;
const FRUSTUM = '#29303f', RAY = 'rgba(104,115,140,0.5)', BEFORE_NEAR = 'rgba(104,115,140,0.18)';
const BOX = '#d96b0d', CULLED = 'rgba(130,132,140,0.8)', RANGE = '#8c3399';
const PANEL = 250;

const shown = () => only === null ? data.cameras : [data.cameras[only]];
const rays = () => only === null || data.alone ? data.rays : data.cameras[only].rays;
const distance = stored => data.near + (data.far - data.near) * stored / data.steps;
const checked = id => element(id).checked;
const frustum = () => {
  const alone = only === null ? data.frustum : Math.max(data.frustum, 0.5 * data.near);
  return alone * 2 ** Number(element('size').value);
};
const corners = camera => camera.corners.map(corner => add(camera.origin, corner, frustum()));
/** The border of a camera's picture at distance t along its rays. */
const border = (camera, t) => camera.corners.flatMap((corner, k) => {
  const way = add(camera.corners[(k + 1) % 4], corner, -1);
  return Array.from({ length: 12 }, (_, i) => {
    const dir = add(corner, way, i / 12);
    return add(camera.origin, dir, t / Math.hypot(...dir));
  });
});

/** Everything to draw, as [depth, function that draws it]. */
function collect(drawn) {
  const items = [];
  const line = (a, b, style, width, draw = stroke) => {
    const ends = view.segment(a, b);
    if (ends) items.push([0.5 * (ends[0][2] + ends[1][2]), () => draw(ends, style, width)]);
  };
  // Long lines in pieces, so that what is before one end is not behind the other.
  const pieces = (a, b, style, width, count) => {
    const at = i => add(a, add(b, a, -1), i / count);
    for (let i = 0; i < count; i++) line(at(i), at(i + 1), style, width);
  };
  if (checked('box')) {
    for (const points of data.outline) points.slice(1).forEach((p, i) => line(points[i], p, BOX, 1.5));
  }
  for (const camera of shown()) {
    const plane = corners(camera);
    const picture = pictures[data.cameras.indexOf(camera)];
    const middle = view.project(scaled(add(add(plane[0], plane[1]), add(plane[2], plane[3])), 0.25));
    if (checked('images') && picture && middle) {
      items.push([middle[2] + 1e-6, () => { drawn.images += photograph(picture, plane); }]);
    }
    if (checked('frusta')) {
      for (let i = 0; i < 4; i++) {
        const [style, width] = [camera.colour || FRUSTUM, camera.colour ? 2 : 1];
        line(camera.origin, plane[i], style, width);
        line(plane[i], plane[(i + 1) % 4], style, width);
      }
    }
    if (checked('range') && only !== null) {
      for (const t of [camera.near, data.far]) {
        const edge = border(camera, t);
        edge.forEach((p, i) => line(p, edge[(i + 1) % edge.length], RANGE, 1.2));
      }
    }
    drawn.cameras += 1;
  }
  for (const ray of rays()) {
    const { origin, near } = data.cameras[ray.camera];
    const at = t => add(origin, ray.dir, t);
    if (checked('rays')) {
      line(origin, at(near), BEFORE_NEAR, 1);
      pieces(at(near), at(data.far), RAY, 1, 8);
      drawn.rays += 1;
    }
    const dots = (stored, draw) => {
      for (const t of stored.map(distance)) {
        const p = view.project(at(t));
        if (p) items.push([p[2], () => draw(p, t)]);
      }
    };
    if (checked('culled')) dots(ray.culled, small);
    if (checked('live')) dots(ray.live, large);
    drawn.live += checked('live') ? ray.live.length : 0;
    drawn.culled += checked('culled') ? ray.culled.length : 0;
  }
  return items;
}

function stroke([a, b], style, width) {
  context.strokeStyle = style;
  context.lineWidth = width;
  context.beginPath();
  context.moveTo(a[0], a[1]);
  context.lineTo(b[0], b[1]);
  context.stroke();
}

function small([x, y]) {
  context.fillStyle = CULLED;
  context.fillRect(x - 0.9, y - 0.9, 1.8, 1.8);
}

/** A live sample in one colour, drawn once at twice its size: thousands are stamped in every frame. */
function stamp(colour) {
  const dot = document.createElement('canvas');
  dot.width = dot.height = 12;
  const ink = dot.getContext('2d');
  for (const [style, radius] of [['rgba(38,38,51,0.6)', 5.4], [colour, 4.2]]) {
    ink.fillStyle = style;
    ink.beginPath();
    ink.arc(6, 6, radius, 0, 7);
    ink.fill();
  }
  return dot;
}

function large([x, y], t) {
  const [low, high] = data.colour_range;
  const share = Math.max(0, Math.min(1, (t - low) / (high - low)));
  context.drawImage(stamps[Math.round(share * (stamps.length - 1))], x - 3, y - 3, 6, 6);
}

/** Draws a picture on a plane as parallelograms, as many as perspective calls for. Returns 1 if drawn. */
function photograph(picture, [a, b, c, d]) {
  const at = (u, v) => {
    const top = add(a, add(b, a, -1), u), bottom = add(d, add(c, d, -1), u);
    return view.project(add(top, add(bottom, top, -1), v));
  };
  const [p, q, r, s] = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
  const bend = p && q && r && s ? Math.hypot(p[0] + r[0] - q[0] - s[0], p[1] + r[1] - q[1] - s[1]) : 1e3;
  const n = Math.max(1, Math.min(16, Math.ceil(Math.sqrt(bend))));
  const [w, h] = [picture.naturalWidth / n, picture.naturalHeight / n];
  const ratio = canvas.width / view.width;
  for (let j = 0; j < n; j++) for (let i = 0; i < n; i++) {
    const corner = at(i / n, j / n), right = at((i + 1) / n, j / n), down = at(i / n, (j + 1) / n);
    if (!corner || !right || !down) continue;
    const x = [(right[0] - corner[0]) / w, (right[1] - corner[1]) / w];
    const y = [(down[0] - corner[0]) / h, (down[1] - corner[1]) / h];
    context.setTransform(ratio * x[0], ratio * x[1], ratio * y[0], ratio * y[1], ratio * corner[0], ratio * corner[1]);
    // A pixel larger than its cell, so that no seam shows.
    const [more, lower] = [i + 1 < n ? 1 / Math.hypot(...x) : 0, j + 1 < n ? 1 / Math.hypot(...y) : 0];
    context.drawImage(picture, i * w, j * h, w, h, 0, 0, w + more, h + lower);
  }
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return 1;
}

/** A word on a halo, beside a place of the canvas. */
function write(word, [x, y], style) {
  context.font = '600 15px system-ui, sans-serif';
  context.lineWidth = 4;
  context.strokeStyle = '#fff';
  context.strokeText(word, x + 4, y - 4);
  context.fillStyle = style;
  context.fillText(word, x + 4, y - 4);
}

function drawAxes() {
  for (const axis of data.axes) {
    const ends = view.segment(axis.from, axis.to);
    if (!ends) continue;
    stroke(ends, axis.colour, 2.5);
    write(axis.name, ends[1], axis.colour);
  }
}

/** Where the rays of the one camera that is shown begin and end. */
function nameRange() {
  for (const [name, t] of [['near', data.near], ['far', data.far]]) {
    const at = view.project(border(data.cameras[only], t)[0]);
    if (at) write(`${name} ${Number(t.toFixed(3))}`, at, RANGE);
  }
}

function draw() {
  const ratio = canvas.width / view.width;
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.fillStyle = '#fff';
  context.fillRect(0, 0, view.width, view.height);
  const drawn = { cameras: 0, images: 0, rays: 0, live: 0, culled: 0 };
  const items = collect(drawn).sort((a, b) => b[0] - a[0]);
  for (const item of items) item[1]();
  if (checked('axes')) drawAxes();
  if (checked('range') && only !== null) nameRange();
  Object.assign(body.dataset, drawn);
  body.dataset.matrix = view.matrix().map(x => x.toFixed(4)).join(' ');
}

const stamps = data.colours.map(stamp);
let waiting = false;
function redraw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => { waiting = false; draw(); });
}

function resize() {
  const { width, height } = canvas.getBoundingClientRect();
  const ratio = Math.min(2, devicePixelRatio || 1);
  canvas.width = Math.max(1, Math.round(width * ratio));
  canvas.height = Math.max(1, Math.round(height * ratio));
  view.resize(Math.max(1, width), Math.max(1, height));
}

/** What the viewpoint must hold. */
function content() {
  const points = data.outline.flat();
  for (const camera of shown()) {
    points.push(camera.origin, ...corners(camera));
    if (only !== null) points.push(...border(camera, camera.near), ...border(camera, data.far));
  }
  for (const ray of rays()) {
    const { origin, near } = data.cameras[ray.camera];
    points.push(add(origin, ray.dir, near), add(origin, ray.dir, data.far));
  }
  return points;
}

function reset(towards) {
  if (!towards && only !== null && !data.alone) {
    // Behind the camera's shoulder.
    const from = add(data.cameras[only].origin, data.centre, -1);
    const angle = Math.atan2(dot(from, data.across[1]), dot(from, data.across[0])) + 40 * Math.PI / 180;
    const flat = add(scaled(data.across[0], Math.cos(angle)), data.across[1], Math.sin(angle));
    towards = add(scaled(flat, Math.cos(0.42)), data.up, Math.sin(0.42));
  }
  view.lookFrom(towards || data.towards);
  view.fit(content(), view.width > 640 ? PANEL : 0);
  redraw();
}

function select(index) {
  only = index;
  element('camera').value = index === null ? '' : String(index);
  const sum = kind => rays().reduce((sum, ray) => sum + ray[kind].length, 0);
  const camera = index === null ? null : data.cameras[index];
  const who = camera ? `camera ${camera.index} (${camera.name})` : `${data.cameras.length} cameras`;
  element('status').textContent = data.rays.length
    ? `${who}: ${rays().length} rays, ${sum('live')} live samples, ${sum('culled')} culled` : who;
  reset();
}

function step(by) {
  const count = data.cameras.length;
  if (count > 1) select(only === null ? (by > 0 ? 0 : count - 1) : (only + by + count) % count);
}

/** The camera whose centre or picture is nearest to a place of the canvas, if it is near. */
function under(x, y) {
  let best = null, nearest = 16;
  shown().forEach(camera => {
    const plane = corners(camera);
    for (const p of [camera.origin, scaled(add(plane[0], plane[2]), 0.5)].map(p => view.project(p))) {
      const far = p ? Math.hypot(p[0] - x, p[1] - y) : Infinity;
      if (far < nearest) [nearest, best] = [far, data.cameras.indexOf(camera)];
    }
  });
  return best;
}

const held = new Map();
let moved = 0;
canvas.addEventListener('pointerdown', event => {
  held.set(event.pointerId, [event.clientX, event.clientY]);
  if (held.size === 1) moved = 0;
  // A synthetic pointer cannot be captured.
  if (event.isTrusted) canvas.setPointerCapture(event.pointerId);
  canvas.classList.add('turning');
});
canvas.addEventListener('pointermove', event => {
  const last = held.get(event.pointerId);
  if (!last) return hover(event);
  const now = [event.clientX, event.clientY];
  const [dx, dy] = [now[0] - last[0], now[1] - last[1]];
  moved += Math.hypot(dx, dy);
  if (held.size === 2) {
    // Two fingers: each moves by half; their distance zooms.
    const other = [...held].find(([id]) => id !== event.pointerId)[1];
    const apart = p => Math.max(10, Math.hypot(p[0] - other[0], p[1] - other[1]));
    view.zoom(apart(last) / apart(now));
    view.move(0.5 * dx, 0.5 * dy);
  } else if (event.shiftKey || event.buttons & 2) {
    view.move(dx, dy);
  } else {
    view.turn(dx, dy);
  }
  held.set(event.pointerId, now);
  element('tip').hidden = true;
  redraw();
});
const released = event => {
  const place = canvas.getBoundingClientRect();
  const clicked = held.delete(event.pointerId) && event.type === 'pointerup' && moved < 4 && event.button === 0;
  if (!held.size) canvas.classList.remove('turning');
  const found = clicked ? under(event.clientX - place.left, event.clientY - place.top) : null;
  if (found !== null && only === null) select(found);
};
canvas.addEventListener('pointerup', released);
canvas.addEventListener('pointercancel', released);
canvas.addEventListener('contextmenu', event => event.preventDefault());
canvas.addEventListener('pointerleave', () => { element('tip').hidden = true; });
canvas.addEventListener('wheel', event => {
  event.preventDefault();
  const pixels = event.deltaY * (event.deltaMode === 1 ? 30 : 1);
  view.zoom(Math.exp(0.0015 * Math.max(-300, Math.min(300, pixels))));
  redraw();
}, { passive: false });

function hover(event) {
  const place = canvas.getBoundingClientRect();
  const [x, y] = [event.clientX - place.left, event.clientY - place.top];
  const found = under(x, y);
  const tip = element('tip');
  tip.hidden = found === null;
  if (found === null) return;
  tip.textContent = `camera ${data.cameras[found].index}: ${data.cameras[found].name}`;
  tip.style.left = `${Math.min(x + 12, view.width - tip.offsetWidth - 4)}px`;
  tip.style.top = `${Math.max(4, y - 28)}px`;
}

const keys = {
  r: () => reset(), Home: () => reset(), t: () => reset(data.up), a: () => data.alone || select(null),
  n: () => step(1), p: () => step(-1), '+': () => view.zoom(0.9), '=': () => view.zoom(0.9),
  '-': () => view.zoom(1 / 0.9), ArrowLeft: () => view.turn(-12, 0), ArrowRight: () => view.turn(12, 0),
  ArrowUp: () => view.turn(0, -12), ArrowDown: () => view.turn(0, 12),
};
addEventListener('keydown', event => {
  const typing = ['INPUT', 'SELECT'].includes(event.target.tagName);
  const action = keys[event.key] || keys[event.key.toLowerCase()];
  if (!action || typing || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  action();
  redraw();
});

/** What was found of the capture, and two photographs that cannot both be right. */
function showFindings() {
  const put = (parent, kind, text) => {
    const made = parent.appendChild(document.createElement(kind));
    made.textContent = text;
    return made;
  };
  const findings = element('findings');
  findings.hidden = data.findings.length === 0;
  findings.parentElement.classList.toggle('found', !findings.hidden);
  for (const finding of data.findings) put(findings, 'p', finding);
  if (!data.pair.length) return;
  put(findings, 'p', 'These two cannot both be where they are:');
  const pair = put(findings, 'div', '');
  pair.className = 'pair';
  for (const { name, image } of data.pair) {
    const figure = put(pair, 'figure', '');
    put(figure, 'img', '').src = image;
    put(figure, 'figcaption', name);
  }
}

function start() {
  showFindings();
  for (const id of ['rays', 'live', 'culled', 'bar']) element(id).parentElement.hidden = !data.rays.length;
  const chooser = element('camera');
  if (!data.alone) chooser.add(new Option(`all ${data.cameras.length}`, ''));
  data.cameras.forEach((camera, i) => chooser.add(new Option(`${camera.index}: ${camera.name}`, i)));
  chooser.addEventListener('change', () => select(chooser.value === '' ? null : Number(chooser.value)));
  element('panel').addEventListener('input', redraw);
  element('panel').addEventListener('submit', event => event.preventDefault());
  element('reset').addEventListener('click', () => reset());
  element('above').addEventListener('click', () => reset(data.up));
  element('length').textContent = data.axes_length;
  element('ends').textContent = data.ends;
  element('bar').style.background = `linear-gradient(to right, ${data.colours.join(', ')})`;
  element('low').textContent = data.colour_range[0].toFixed(2);
  element('high').textContent = data.colour_range[1].toFixed(2);
  addEventListener('resize', () => { resize(); reset(); });
  resize();
  select(only);
  draw();
  const loads = data.cameras.map(async (camera, i) => {
    const picture = new Image();
    picture.src = camera.image;
    await picture.decode();
    pictures[i] = picture;
  });
  Promise.all(loads).then(() => {
    draw();
    if (location.hash === '#selftest') selfTest();
    body.dataset.ready = 'true';
  });
}
