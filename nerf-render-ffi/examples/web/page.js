
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
const EMPTY = [22, 24, 29];
/** Planes of each mode; what is not among them is not computed. */
const MODES = { colour: ['rgb'], depth: ['opacity', 'z_depth'], normals: ['normals'] };
/** Viridis, from far to near. */
const SCALE = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];

const canvas = element('canvas');
const context = canvas.getContext('2d', { alpha: false });
const sleep = milliseconds => new Promise(done => setTimeout(done, milliseconds));
const bytes = id => Uint8Array.from(atob(element(id).textContent.trim()), letter => letter.charCodeAt(0));

/** A worker whose messages are promises. */
class Thread {
  constructor(url) {
    this.waiting = new Map();
    this.last = 0;
    this.worker = new Worker(url);
    this.worker.onerror = failed;
    this.worker.onmessage = ({ data }) => {
      const { resolve, reject } = this.waiting.get(data.id);
      this.waiting.delete(data.id);
      if (data.error === undefined) resolve(data.found); else reject(new Error(data.error));
    };
  }

  ask(call, more) {
    const id = ++this.last;
    this.worker.postMessage({ id, call, with: more });
    return new Promise((resolve, reject) => this.waiting.set(id, { resolve, reject }));
  }
}

let threads = [], retired = [], info = null, view = null, mode = 'colour', pace = null;
/** Goes up with everything that changes the picture. */
let generation = 0, changed = () => {};
/** Milliseconds of one thread for a pixel of a frame while the view moves, as measured last. */
let pixelMs = null;

function change() {
  generation += 1;
  body.dataset.state = 'moving';
  changed();
}

/** Depth's ends: the scene box seen from the camera. */
function depthRange() {
  const half = 0.5 * Math.hypot(...add(info.box_max, info.box_min, -1));
  return [Math.max(0, view.distance - half), view.distance + half];
}

/** Colours of a tile's pixels, 8 bits a channel. */
function colours(planes, pixels) {
  const made = new Uint8ClampedArray(4 * pixels);
  const [low, high] = depthRange();
  for (let i = 0; i < pixels; i++) {
    let colour;
    if (mode === 'depth') {
      const share = Math.max(0, Math.min(1, (high - planes.z_depth[i]) / (high - low))) * (SCALE.length - 1);
      const left = Math.min(SCALE.length - 2, Math.floor(share));
      const full = add(SCALE[left], add(SCALE[left + 1], SCALE[left], -1), share - left);
      colour = add(scaled(full, planes.opacity[i]), EMPTY, 1 - planes.opacity[i]);
    } else if (mode === 'normals') {
      const normal = [0, 1, 2].map(k => planes.normals[3 * i + k]);
      colour = normal.every(x => x === 0) ? EMPTY : normal.map(x => 127.5 + 127.5 * x);
    } else {
      colour = [0, 1, 2].map(k => Math.floor(255 * Math.max(0, Math.min(1, planes.rgb[3 * i + k])) + 0.5));
    }
    made.set(colour, 4 * i);
    made[4 * i + 3] = 255;
  }
  return made;
}

/** Tiles of a picture, those in the middle first. */
function tiles(width, height) {
  const all = [];
  for (let y = 0; y < height; y += TILE) for (let x = 0; x < width; x += TILE) {
    all.push({ x, y, width: Math.min(TILE, width - x), height: Math.min(TILE, height - y) });
  }
  const off = tile => Math.hypot(tile.x + 0.5 * TILE - 0.5 * width, tile.y + 0.5 * TILE - 0.5 * height);
  return all.sort((a, b) => off(a) - off(b));
}

/**
 * Renders a picture tile by tile on all threads, `paint` as they come, until it is done or not `wanted`.
 * Returns the work and the threads' milliseconds, or null where it was not wanted to the end.
 */
async function frame(request, paint, wanted) {
  const { width, height } = request.camera;
  const left = tiles(width, height), counters = {};
  let busy = 0, whole = true;
  await Promise.all(threads.map(async thread => {
    while (left.length) {
      const rect = left.shift();
      const found = await thread.ask('render', { ...request, rect });
      if (!wanted()) { whole = false; return; }
      busy += found.milliseconds;
      for (const [name, count] of Object.entries(found.counters)) {
        if (name !== 'struct_size') counters[name] = (counters[name] || 0n) + count;
      }
      paint(rect, new ImageData(colours(found.planes, rect.width * rect.height), rect.width, rect.height));
    }
  }));
  return whole ? { counters, busy } : null;
}

/** Settings and size of a frame that should take `MOVING_MS`: by the scene's front where it has one, then by size. */
async function quick() {
  const { width, height } = canvas;
  let options = null, loss = null, expected = pixelMs;
  if (pace) {
    const found = await threads[0].ask('within', { milliseconds: MOVING_MS * threads.length, pace });
    loss = found.choice.loss_db;
    options = found.options;
    expected ??= found.choice.milliseconds / (width * height);
  }
  const pixels = expected ? MOVING_MS * threads.length / expected : 0;
  const share = Math.max(1 / 8, Math.min(1, Math.sqrt(pixels / (width * height))));
  const size = [width, height].map(side => Math.max(16, Math.round(share * side)));
  return { options, loss, size };
}

/** One picture as fast as it must be, whatever happens meanwhile, shown when it is whole. */
async function drawQuickly() {
  const { options, loss, size: [width, height] } = await quick();
  const small = new OffscreenCanvas(width, height);
  const ink = small.getContext('2d', { alpha: false });
  const began = performance.now();
  const camera = view.camera(width, height, ANGLE);
  const { busy } = await frame({ camera, options, planes: MODES[mode] },
    (rect, image) => ink.putImageData(image, rect.x, rect.y), () => true);
  pixelMs = busy / (width * height);
  context.drawImage(small, 0, 0, canvas.width, canvas.height);
  const lost = loss === null ? '' : `, ${loss.toFixed(2)} dB lost`;
  element('moving').textContent = `${Math.round(performance.now() - began)} ms at ${width}×${height}${lost}`;
  Object.assign(body.dataset, { quick: Number(body.dataset.quick || 0) + 1, quickWidth: width });
}

/** The picture in full, tile by tile, unless the view changes meanwhile. */
async function drawFully(now) {
  const planes = MODES[mode], { width, height } = canvas;
  const began = performance.now();
  const done = await frame({ camera: view.camera(width, height, ANGLE), planes },
    (rect, image) => context.putImageData(image, rect.x, rect.y), () => generation === now);
  if (!done) return;
  const spent = performance.now() - began;
  const rate = 2 * Number(done.counters.macs) / done.busy / 1e6;
  element('still').textContent = `${Math.round(spent)} ms at ${width}×${height}`;
  element('threads').textContent = `${threads.length}, ${rate.toFixed(1)} GFLOP/s each`;
  element('explain').textContent = await threads[0].ask('explain', { planes, counters: done.counters });
  body.dataset.milliseconds = Math.round(spent);
}

/** The whole life of the page: a quick picture for each change, and the full one at rest. */
async function draw() {
  for (;;) {
    const now = generation;
    const next = new Promise(resolve => { changed = resolve; });
    for (const thread of retired.splice(0)) thread.worker.terminate();
    if (mode === 'depth') {
      const [low, high] = depthRange();
      element('low').textContent = low.toFixed(2);
      element('high').textContent = high.toFixed(2);
    }
    await drawQuickly();
    await Promise.race([next, sleep(REST_MS)]);
    if (generation !== now) continue;
    await drawFully(now);
    if (generation !== now) continue;
    if (info.front_points && !pace) {
      // Only now, since nothing else may run; it decides the next quick picture.
      const camera = view.camera(canvas.width, canvas.height, ANGLE);
      const limit = 4 * MOVING_MS * threads.length;
      const found = await threads[0].ask('pace', { camera, planes: MODES.colour, limit });
      // Of another size or kernel by now, perhaps.
      if (generation !== now) continue;
      pace = found;
      pixelMs = null;
      body.dataset.pace = pace.map(x => Number.isFinite(x) ? x.toFixed(1) : '').join(' ').trim();
    }
    body.dataset.state = generation === now ? 'rest' : 'moving';
    await next;
  }
}

/** The middle of what is to be seen from four sides of the scene box; the box's own where that is nothing. */
async function middle() {
  const centre = scaled(add(info.box_min, info.box_max), 0.5), side = 24;
  let [sum, weight] = [[0, 0, 0], 0];
  for (let i = 0; i < 4; i++) {
    const from = Object.assign(new Orbit(centre, view.home, view.up, view.across), { azimuth: i * Math.PI / 2 });
    const camera = from.camera(side, side, ANGLE), column = k => [0, 4, 8].map(row => camera.c2w[row + k]);
    const rect = { x: 0, y: 0, width: side, height: side };
    const { planes } = await threads[0].ask('render', { camera, rect, planes: MODES.depth });
    planes.opacity.forEach((opacity, pixel) => {
      const [x, y] = [pixel % side + 0.5 - camera.cx, camera.cy - Math.floor(pixel / side) - 0.5];
      const way = add(add(scaled(column(0), x / camera.fx), column(1), y / camera.fy), column(2), -1);
      sum = add(sum, add(column(3), way, planes.z_depth[pixel]), opacity);
      weight += opacity;
    });
  }
  return weight > 1 ? scaled(sum, 1 / weight) : centre;
}

/** Opens the scene on every thread with a kernel. */
async function open(kernel) {
  const [module, blob] = [new WebAssembly.Module(bytes('module')), bytes('blob')];
  body.dataset.imports = WebAssembly.Module.imports(module).map(it => it.name).join(' ');
  body.dataset.exports = WebAssembly.Module.exports(module).map(it => it.name).join(' ');
  const url = URL.createObjectURL(new Blob([element('library').textContent], { type: 'text/javascript' }));
  const count = Math.max(1, Math.min(8, navigator.hardwareConcurrency || 1));
  const made = Array.from({ length: count }, () => new Thread(url));
  const infos = await Promise.all(made.map(thread => thread.ask('open', { module, blob, kernel })));
  // A frame that is under way ends on the old ones.
  retired.push(...threads);
  [threads, info, pace, pixelMs] = [made, infos[0], null, null];
  body.dataset.kernel = info.kernel;
  if (info.kind !== 1) throw new Error('this page draws scenes, and the file holds a picture');
}

const actions = {
  turn: (dx, dy) => { view.turn(dx, dy); change(); },
  dolly: factor => { view.dolly(factor); change(); },
  reset: () => { view.reset(); change(); },
  show: name => {
    mode = name;
    pixelMs = null;
    element('legend').hidden = mode !== 'depth';
    document.querySelector(`input[value=${name}]`).checked = true;
    change();
  },
};

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
  r: () => actions.reset(), 1: () => actions.show('colour'), 2: () => actions.show('depth'),
  3: () => actions.show('normals'), '+': () => actions.dolly(0.9), '=': () => actions.dolly(0.9),
  '-': () => actions.dolly(1 / 0.9), ArrowLeft: () => actions.turn(-12, 0), ArrowRight: () => actions.turn(12, 0),
  ArrowUp: () => actions.turn(0, -12), ArrowDown: () => actions.turn(0, 12),
};
addEventListener('keydown', event => {
  const action = keys[event.key] || keys[event.key.toLowerCase()];
  const typing = ['INPUT', 'SELECT'].includes(event.target.tagName);
  if (!action || typing || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  action();
});

function resize() {
  canvas.width = canvas.height = Number(element('size').value);
  // What was measured at another size says nothing here.
  pace = null;
  change();
}

async function start() {
  const words = location.hash.slice(1).split(',');
  if (words.includes('selftest')) selfTest(words);
  await open('simd128');
  const [x, y, z] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  const home = 0.5 * (info.near_distance + info.far_distance);
  // Blender's scenes stand on the xy plane.
  view = words.includes('y-up') ? new Orbit(null, home, y, [z, x]) : new Orbit(null, home, z, [x, y]);
  view.centre = await middle();
  element('facts').textContent = `${info.data}: ${info.parameters} parameters, trunk ${info.trunk_widths
    .slice(0, info.trunk_layers).join('-')}, ${info.samples} samples a ray, kernel ${info.kernel}`;
  element('bar').style.background = `linear-gradient(to left, ${SCALE.map(c => `rgb(${c})`).join(', ')})`;
  element('panel').addEventListener('submit', event => event.preventDefault());
  element('modes').addEventListener('change', event => actions.show(event.target.value));
  element('size').addEventListener('change', resize);
  element('kernel').addEventListener('change', async event => { await open(event.target.value); change(); });
  element('reset').addEventListener('click', actions.reset);
  if (words.includes('depth')) actions.show('depth');
  if (words.includes('normals')) actions.show('normals');
  resize();
  body.dataset.ready = 'true';
  draw();
}
