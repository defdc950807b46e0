
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

let threads = [], retired = [], info = null, view = null, pace = null, module = null, blob = null;
/** What is shown of the scene; `range`: null for that of the picture; `crop`: null, or a box. */
const look = { mode: 'colour', map: 'viridis', range: null, crop: null };
/** The pose of a flight under way, or null. */
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

/** The camera of a picture of this size: of a flight, of a photograph, or the one that goes around. */
function cameraNow(width, height) {
  if (flying) return cameraOf(flying, width, height, 0.5 * Math.min(width, height) / Math.tan(0.5 * ANGLE));
  return photograph ? resized(photograph.camera, width, height) : view.camera(width, height, ANGLE);
}

const poseNow = () => flying ?? photograph?.camera.c2w ?? view.pose();

/** Where most of the numbers of a picture lie that are of something opaque. */
function rangeOf(mode, tiles) {
  const name = MODES[mode].planes.at(-1);
  if (mode === 'opacity') return [0, 1];
  const numbers = tiles.flatMap(({ planes }) => planes.opacity
    ? Array.from(planes[name]).filter((_, i) => planes.opacity[i] > 0.5) : []).sort((a, b) => a - b);
  if (!numbers.length) return [0, 1];
  const [low, high] = [0.02, 0.98].map(share => numbers[Math.floor(share * (numbers.length - 1))]);
  return [low, Math.max(high, low + 1e-6 * Math.abs(low) + 1e-9)];
}

/** A tile's colours as they are now to be shown. */
const developed = ({ rect, planes }) => new ImageData(colours(look.mode, planes, rect.width * rect.height,
  mapOf(look.mode, look.map), look.range ?? ownRange), rect.width, rect.height);

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
 * Renders a picture tile by tile on all threads, which `take` gets as they come, until it is done or not `wanted`.
 * Returns the work and the threads' milliseconds, or null where it was not wanted to the end.
 */
async function frame(request, take, wanted) {
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
      take({ rect, planes: found.planes });
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
  const began = performance.now(), tiles = [];
  const { mode, crop } = look, planes = MODES[mode].planes;
  const { busy } = await frame({ camera: cameraNow(width, height), options, planes, crop },
    tile => tiles.push(tile), () => true);
  pixelMs = busy / (width * height);
  // Of another kind by now, perhaps.
  if (mode === look.mode) {
    const small = new OffscreenCanvas(width, height), ink = small.getContext('2d', { alpha: false });
    if (MODES[mode].unit) ownRange = rangeOf(mode, tiles);
    for (const tile of tiles) ink.putImageData(developed(tile), tile.rect.x, tile.rect.y);
    context.drawImage(small, 0, 0, canvas.width, canvas.height);
    tellRange();
  }
  const spent = performance.now() - began, lost = loss === null ? '' : `, ${loss.toFixed(2)} dB lost`;
  element('moving').textContent =
    `${Math.round(1000 / spent)} frames/s: ${Math.round(spent)} ms at ${width}×${height}${lost}`;
  Object.assign(body.dataset, {
    quick: Number(body.dataset.quick || 0) + 1, quickWidth: width, framesASecond: Math.round(1000 / spent),
  });
  body.dataset.firstPicture ??= Date.now();
  painted();
}

/** The picture in full, tile by tile, unless the view changes meanwhile. */
async function drawFully(now) {
  const { planes } = MODES[look.mode], { width, height } = canvas;
  const began = performance.now();
  const done = await frame({ camera: cameraNow(width, height), planes, crop: look.crop },
    tile => context.putImageData(developed(tile), tile.rect.x, tile.rect.y), () => generation === now);
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
    await drawQuickly();
    await Promise.race([next, sleep(REST_MS)]);
    if (generation !== now || flying) continue;
    await drawFully(now);
    if (generation !== now) continue;
    if (info.front_points && !pace) {
      // Only now, since nothing else may run; it decides the next quick picture.
      const camera = cameraNow(canvas.width, canvas.height);
      const limit = 4 * MOVING_MS * threads.length;
      const found = await threads[0].ask('pace', { camera, planes: MODES.colour.planes, limit });
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

/** Opens the scene on every thread with a kernel. */
async function open(kernel) {
  module ??= new WebAssembly.Module(bytes('module'));
  blob ??= await firstBlob();
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

/** The scene in a newer state, on the threads there are. */
async function reopen(newer) {
  blob = newer;
  [info] = await Promise.all(threads.map(thread => thread.ask('open', { module, blob, kernel: info.kernel })));
  pace = null;
  if (!touched) view.centre = await middle();
  change();
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

/** Poses to fly through. */
const keyframes = [];

function tellKeyframes() {
  const count = keyframes.length;
  element('keyframes').textContent = `${count} view${count === 1 ? '' : 's'}`;
  for (const id of ['save', 'clear']) element(id).disabled = !count;
  element('preview').disabled = count < 2;
}

const flightSeconds = () => Math.max(0.1, Number(element('seconds').value) || 4);

/** Shows the flight in its own time, as many frames of it as there is time for. */
async function preview() {
  if (keyframes.length < 2 || flying) return;
  const along = flight(keyframes), seconds = flightSeconds(), began = performance.now();
  for (let share = 0, shown = 0; ; shown++) {
    flying = along(share);
    const next = new Promise(resolve => { painted = resolve; });
    change();
    await next;
    body.dataset.flown = shown + 1;
    if (share === 1) break;
    share = Math.min(1, (performance.now() - began) / 1000 / seconds);
  }
  flying = null;
  change();
}

/** The flight as a file. */
const pathNow = () => pathFile(keyframes, flightSeconds(), [canvas.width, canvas.height],
  2 * Math.atan(Math.tan(0.5 * ANGLE) * canvas.height / Math.min(canvas.width, canvas.height)) * 180 / Math.PI);

function save() {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(new Blob([JSON.stringify(pathNow())], { type: 'application/json' }));
  link.download = 'camera_path.json';
  link.click();
  URL.revokeObjectURL(link.href);
}

const actions = {
  turn: (dx, dy) => { view.turn(dx, dy); touched = true; change(); },
  dolly: factor => { view.dolly(factor); touched = true; change(); },
  reset: () => { view.reset(); compare(-1); },
  show: name => {
    look.mode = name;
    look.range = null;
    pixelMs = null;
    document.querySelector(`input[value=${name}]`).checked = true;
    tellRange();
    change();
  },
  keep: () => { keyframes.push([...poseNow()]); tellKeyframes(); },
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
  if (photograph) return;
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
  // Blender's scenes stand on the xy plane.
  view = words.includes('y-up') ? new Orbit(null, home, y, [z, x]) : new Orbit(null, home, z, [x, y]);
  view.centre = await middle();
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
