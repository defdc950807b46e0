import { ANGLE, sleep } from './draw.js';
import { library } from './threads.js';

const body = document.body;
const failed = event => {
  body.dataset.errors = Number(body.dataset.errors) + 1;
  const said = event.message || event.reason || event.violatedDirective || 'error';
  element('status').textContent = body.dataset.error = String(said).slice(0, 200);
};
for (const kind of ['error', 'unhandledrejection', 'securitypolicyviolation']) addEventListener(kind, failed);

const scene = element('scene'), canvas = scene.shadowRoot.querySelector('canvas');
scene.addEventListener('error', failed);
/** What draws the scene, and the blob that is shown. */
let picture = null, blob = null;
/** The keyframe that a flight under way has come to, or null. */
let flying = null;

/** The colour map's ends, as they are or as they were asked for. */
function tellRange() {
  const { look: { mode, map, range }, ownRange } = picture, [low, high] = range ?? ownRange ?? [0, 1], { unit } = MODES[mode];
  element('legend').hidden = !unit;
  if (!unit) return;
  element('unit').textContent = unit;
  for (const [id, value] of [['low', low], ['high', high]]) {
    const input = element(id);
    if (document.activeElement !== input) input.value = Number(value.toPrecision(4));
  }
  element('bar').style.background = `linear-gradient(to right, ${mapOf(mode, map).map(c => `rgb(${c})`).join(', ')})`;
}

/** Shows something else of the scene. */
function look(more) {
  picture.show(more);
  tellRange();
}

const actions = {
  reset: () => { picture.cover = null; compare(-1); scene.reset(); },
  show: name => {
    document.querySelector(`input[value=${name}]`).checked = true;
    scene.output = name;
    tellRange();
  },
  keep: () => { keyframes.push(keyframeNow()); tellKeyframes(); },
  preview,
};

/** A keyframe of what is shown: its pose, and its vertical field of view in radians. */
function keyframeNow() {
  const { c2w, height, fy } = picture.camera(...picture.size);
  return { pose: [...c2w], fov: 2 * Math.atan(0.5 * height / fy) };
}

/** The camera in place of the one that goes around: of a flight, of a photograph, or none. */
function cover() {
  const { pose, fov } = flying ?? {}, camera = photograph?.camera;
  picture.cover = flying ? (width, height) => cameraOf(pose, width, height, 0.5 * height / Math.tan(0.5 * fov))
    : camera ? (width, height) => resized(camera, width, height) : null;
  picture.flying = Boolean(flying);
  picture.change();
}

/** The crop box as the sliders say, or none. */
function crop() {
  const { info } = picture, on = element('crop').checked;
  const at = (end, axis) => {
    const [low, high] = [info.box_min[axis], info.box_max[axis]];
    return low + (high - low) * element(`crop-${end}-${axis}`).value / 100;
  };
  const box = end => [0, 1, 2].map(axis => at(end, axis));
  element('crop-box').hidden = !on;
  look({ crop: on ? { min: box('min'), max: box('max') } : null });
}

const keys = {
  k: () => actions.keep(), p: () => actions.preview(), r: () => actions.reset(),
  ...Object.fromEntries(MODE_NAMES.map((name, i) => [i + 1, () => actions.show(name)])),
};
addEventListener('keydown', event => {
  const action = keys[event.key.toLowerCase()];
  const typing = ['INPUT', 'SELECT'].includes(event.target.tagName);
  if (!action || typing || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  action();
});

function resize() {
  const { width, height } = photograph?.camera ?? { width: 1, height: 1 };
  element('frame').style.setProperty('--aspect', width / height);
  scene.setAttribute('pixels', element('size').value);
  scene.resize();
}

/** What is said of each picture. */
async function tellPicture({ detail: { full, width, height, milliseconds, loss, planes, counters, busy } }) {
  const spent = Math.round(milliseconds), lost = typeof loss === 'number' ? `, ${loss.toFixed(2)} dB lost` : '';
  if (!full) {
    tellRange();
    const rate = Math.round(1000 / milliseconds);
    element('moving').textContent = `${rate} frames/s: ${spent} ms at ${width}×${height}${lost}`;
    Object.assign(body.dataset, { quick: Number(body.dataset.quick || 0) + 1, quickWidth: width, framesASecond: rate });
    body.dataset.firstPicture ??= Date.now();
    return;
  }
  element('still').textContent = `${spent} ms at ${width}×${height}`;
  element('threads').textContent =
    `${picture.threads.length}, ${(2 * Number(counters.macs) / busy / 1e6).toFixed(1)} GFLOP/s each`;
  body.dataset.milliseconds = spent;
  element('explain').textContent = await picture.threads[0].ask('explain', { planes, counters });
}

/** What each control does. */
function connect() {
  const on = (id, kind, action) => element(id).addEventListener(kind, action);
  on('scene', 'draw', tellPicture);
  on('panel', 'submit', event => event.preventDefault());
  on('modes', 'change', event => actions.show(event.target.value));
  on('map', 'change', event => look({ map: event.target.value }));
  for (const id of ['low', 'high']) {
    on(id, 'change', () => {
      const [low, high] = ['low', 'high'].map(end => Number(element(end).value));
      look({ range: low < high ? [low, high] : null });
    });
  }
  on('auto', 'click', () => look({ range: null }));
  on('size', 'change', resize);
  on('kernel', 'change', async event => {
    await picture.open(blob, event.target.value);
    body.dataset.kernel = picture.info.kernel;
  });
  on('reset', 'click', actions.reset);
  on('photograph', 'change', event => compare(event.target.value === '' ? -1 : Number(event.target.value)));
  // The view of a photograph does not turn: a drag moves the split between photograph and render.
  on('scene', 'pointermove', event => {
    const place = canvas.getBoundingClientRect();
    if (photograph && event.buttons) split((event.clientX - place.left) / place.width);
  });
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
  if (words.includes('y-up')) scene.setAttribute('up', 'y');
  for (const word of words) if (MODES[word]) scene.output = word;
  const module = await library();
  body.dataset.imports = WebAssembly.Module.imports(module).map(it => it.name).join(' ');
  body.dataset.exports = WebAssembly.Module.exports(module).map(it => it.name).join(' ');
  blob = await firstBlob();
  await scene.open(blob);
  picture = scene.picture;
  const { info } = picture;
  body.dataset.kernel = info.kernel;
  element('facts').textContent = `${info.data}: ${info.parameters} parameters, trunk ${info.trunk_widths
    .slice(0, info.trunk_layers).join('-')}, ${info.samples} ${info.step > 0 ? 'march steps' : 'samples a ray'}, kernel ${info.kernel}`;
  connect();
  actions.show(scene.output);
  await readPhotographs();
  tellKeyframes();
  resize();
  scene.focus();
  body.dataset.ready = 'true';
  if (body.dataset.live) follow();
}
