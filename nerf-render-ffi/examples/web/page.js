
const element = id => document.getElementById(id);
const body = document.body;
const failed = event => {
  body.dataset.errors = Number(body.dataset.errors) + 1;
  const said = event.message || event.reason || event.violatedDirective || 'error';
  element('status').textContent = body.dataset.error = String(said).slice(0, 200);
};
for (const kind of ['error', 'unhandledrejection', 'securitypolicyviolation']) addEventListener(kind, failed);

/** A frame while the view moves should take this long. */
const MOVING_MS = 60;
/** The view is at rest after this long. */
const REST_MS = 150;
const TILE = 32;
const ANGLE = 40 * Math.PI / 180;

const canvas = element('canvas');
const context = canvas.getContext('2d', { alpha: false });
const sleep = milliseconds => new Promise(done => setTimeout(done, milliseconds));
const bytes = id => Uint8Array.from(atob(element(id).textContent.trim()), letter => letter.charCodeAt(0));

let threads = [], retired = [], info = null, view = null, pace = null, module = null, blob = null;
/** What is shown of the scene; `range`: null for that of the picture; `crop`: null, or a box. */
const look = { mode: 'colour', map: 'viridis', range: null, crop: null };
/** The keyframe that a flight under way has come to, or null. */
let flying = null;
/** Whether somebody has moved the view. */
let touched = false;
/** Goes up with everything that changes the picture. */
let generation = 0, changed = () => {}, painted = () => {};
/** Milliseconds of one thread for a pixel of a frame while the view moves, as measured last. */
let pixelMs = null;
/** The range of the picture that was drawn last. */
let ownRange = [0, 1];

function change() {
  generation += 1;
  body.dataset.state = 'moving';
  changed();
}

/** The middle of what is to be seen from four sides of the scene box; the box's own where that is nothing. */
async function middle() {
  const centre = scaled(add(info.box_min, info.box_max), 0.5), side = 24;
  let [sum, weight] = [[0, 0, 0], 0];
  for (let i = 0; i < 4; i++) {
    const from = Object.assign(new Orbit(centre, view.home, view.up, view.across), { azimuth: i * Math.PI / 2 });
    const camera = from.camera(side, side, ANGLE), column = k => [0, 4, 8].map(row => camera.c2w[row + k]);
    const rect = { x: 0, y: 0, width: side, height: side };
    const { planes } = await threads[0].ask('render', { camera, rect, planes: MODES.depth.planes });
    planes.opacity.forEach((opacity, pixel) => {
      const [x, y] = [pixel % side + 0.5 - camera.cx, camera.cy - Math.floor(pixel / side) - 0.5];
      const way = add(add(scaled(column(0), x / camera.fx), column(1), y / camera.fy), column(2), -1);
      sum = add(sum, add(column(3), way, planes.z_depth[pixel]), opacity);
      weight += opacity;
    });
  }
  return weight > 1 ? scaled(sum, 1 / weight) : centre;
}

/** The colour map's ends, as they are or as they were asked for. */
function tellRange() {
  const [low, high] = look.range ?? ownRange, { unit } = MODES[look.mode];
  element('legend').hidden = !unit;
  if (!unit) return;
  element('unit').textContent = unit;
  for (const [id, value] of [['low', low], ['high', high]]) {
    const input = element(id);
    if (document.activeElement !== input) input.value = Number(value.toPrecision(4));
  }
  element('bar').style.background =
    `linear-gradient(to right, ${mapOf(look.mode, look.map).map(c => `rgb(${c})`).join(', ')})`;
}

/** Moves the view; a photograph is compared with from its own. */
function move(action) {
  if (photograph) return;
  action();
  touched = true;
  change();
}

const actions = {
  turn: (dx, dy) => move(() => view.turn(dx, dy)),
  dolly: factor => move(() => view.dolly(factor)),
  reset: () => { view.reset(); compare(-1); },
  show: name => {
    look.mode = name;
    look.range = null;
    pixelMs = null;
    document.querySelector(`input[value=${name}]`).checked = true;
    tellRange();
    change();
  },
  keep: () => { keyframes.push(keyframeNow()); tellKeyframes(); },
  preview,
};

/** The crop box as the sliders say, or none. */
function crop() {
  const at = (end, axis) => {
    const [low, high] = [info.box_min[axis], info.box_max[axis]];
    return low + (high - low) * element(`crop-${end}-${axis}`).value / 100;
  };
  const box = end => [0, 1, 2].map(axis => at(end, axis));
  look.crop = element('crop').checked ? { min: box('min'), max: box('max') } : null;
  element('crop-box').hidden = !look.crop;
  pixelMs = null;
  change();
}

const held = new Map();
canvas.addEventListener('pointerdown', event => {
  held.set(event.pointerId, [event.clientX, event.clientY]);
  // A synthetic pointer cannot be captured.
  if (event.isTrusted) canvas.setPointerCapture(event.pointerId);
  canvas.classList.add('turning');
});
canvas.addEventListener('pointermove', event => {
  const last = held.get(event.pointerId);
  if (!last) return;
  const now = [event.clientX, event.clientY];
  if (photograph) {
    const place = canvas.getBoundingClientRect();
    split((now[0] - place.left) / place.width);
    held.set(event.pointerId, now);
    return;
  }
  if (held.size === 2) {
    const other = [...held].find(([id]) => id !== event.pointerId)[1];
    const apart = p => Math.max(10, Math.hypot(p[0] - other[0], p[1] - other[1]));
    actions.dolly(apart(last) / apart(now));
  } else {
    actions.turn(now[0] - last[0], now[1] - last[1]);
  }
  held.set(event.pointerId, now);
});
for (const kind of ['pointerup', 'pointercancel']) {
  canvas.addEventListener(kind, event => {
    held.delete(event.pointerId);
    if (!held.size) canvas.classList.remove('turning');
  });
}
canvas.addEventListener('wheel', event => {
  event.preventDefault();
  const pixels = event.deltaY * (event.deltaMode === 1 ? 30 : 1);
  actions.dolly(Math.exp(0.0015 * Math.max(-300, Math.min(300, pixels))));
}, { passive: false });

const keys = {
  r: () => actions.reset(), k: () => actions.keep(), p: () => actions.preview(),
  '+': () => actions.dolly(0.9), '=': () => actions.dolly(0.9),
  '-': () => actions.dolly(1 / 0.9), ArrowLeft: () => actions.turn(-12, 0), ArrowRight: () => actions.turn(12, 0),
  ArrowUp: () => actions.turn(0, -12), ArrowDown: () => actions.turn(0, 12),
  ...Object.fromEntries(MODE_NAMES.map((name, i) => [i + 1, () => actions.show(name)])),
};
addEventListener('keydown', event => {
  const action = keys[event.key] || keys[event.key.toLowerCase()];
  const typing = ['INPUT', 'SELECT'].includes(event.target.tagName);
  if (!action || typing || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  action();
});

function resize() {
  const size = Number(element('size').value), camera = photograph?.camera;
  const scale = camera ? size / Math.max(camera.width, camera.height) : 1;
  [canvas.width, canvas.height] = camera ? [camera.width, camera.height].map(side => Math.round(scale * side)) : [size, size];
  element('frame').style.setProperty('--aspect', canvas.width / canvas.height);
  // What was measured at another size says nothing here.
  pace = null;
  change();
}

/** What each control does. */
function connect() {
  const on = (id, kind, action) => element(id).addEventListener(kind, action);
  on('panel', 'submit', event => event.preventDefault());
  on('modes', 'change', event => actions.show(event.target.value));
  on('map', 'change', event => { look.map = event.target.value; tellRange(); change(); });
  for (const id of ['low', 'high']) {
    on(id, 'change', () => {
      const [low, high] = ['low', 'high'].map(end => Number(element(end).value));
      look.range = low < high ? [low, high] : null;
      tellRange();
      change();
    });
  }
  on('auto', 'click', () => { look.range = null; tellRange(); change(); });
  on('size', 'change', resize);
  on('kernel', 'change', async event => { await open(event.target.value); change(); });
  on('reset', 'click', actions.reset);
  on('photograph', 'change', event => compare(event.target.value === '' ? -1 : Number(event.target.value)));
  on('keep', 'click', actions.keep);
  on('preview', 'click', actions.preview);
  on('save', 'click', save);
  on('clear', 'click', () => { keyframes.length = 0; tellKeyframes(); });
  on('crop', 'change', crop);
  on('crop-box', 'input', crop);
}

async function start() {
  const words = location.hash.slice(1).split(',');
  if (!element('blob').textContent.trim()) body.dataset.live = 'true';
  if (words.includes('selftest')) selfTest(words);
  await open('simd128');
  const [x, y, z] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  const home = 0.5 * (info.near_distance + info.far_distance);
  if (words.includes('y-up')) view = new Orbit(null, home, y, [z, x]);
  else if (info.up.some(Boolean)) view = Orbit.through(info);
  // Blender's scenes stand on the xy plane.
  else view = new Orbit(null, home, z, [x, y]);
  view.centre ??= await middle();
  element('facts').textContent = `${info.data}: ${info.parameters} parameters, trunk ${info.trunk_widths
    .slice(0, info.trunk_layers).join('-')}, ${info.samples} samples a ray, kernel ${info.kernel}`;
  connect();
  await readPhotographs();
  tellKeyframes();
  for (const word of words) if (MODES[word]) actions.show(word);
  resize();
  body.dataset.ready = 'true';
  if (body.dataset.live) follow();
  draw();
}
