import { add } from './view.js';

/** What is shown: planes of each mode (what is not among them is not computed), and what its numbers are. */
const MODES = {
  colour: { planes: ['rgba'] },
  depth: { planes: ['opacity', 'z_depth'], unit: 'world units', low: 'near' },
  normals: { planes: ['normals'] },
  opacity: { planes: ['opacity'], unit: 'opacity, 0 to 1', low: 'clear' },
  distance: { planes: ['opacity', 'ray_distance'], unit: 'world units', low: 'near' },
  median: { planes: ['opacity', 'median_distance'], unit: 'world units', low: 'near' },
};
const MODE_NAMES = Object.keys(MODES);
/** Colours from the low end to the high one. */
const MAPS = {
  viridis: [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]],
  turbo: [[48, 18, 59], [70, 107, 227], [40, 188, 235], [50, 242, 152], [164, 252, 60], [238, 207, 58], [251, 126, 33],
    [208, 47, 5], [122, 4, 3]],
  grey: [[0, 0, 0], [255, 255, 255]],
};
const EMPTY = [22, 24, 29];
/** Colours that a map is read at, and numbers of a tile that a range is read from: more are not seen, and take time. */
const STEPS = 1024, SAMPLES = 256;

/** A colour map at a share of its length. */
function mapped(map, share) {
  const at = share * (map.length - 1), left = Math.min(map.length - 2, Math.floor(at));
  return add(map[left], add(map[left + 1], map[left], -1), at - left);
}

/** The map of a mode: what is near is bright. */
const mapOf = (mode, name) => MODES[mode].low === 'near' ? [...MAPS[name]].reverse() : MAPS[name];

const tables = new Map();
/** Colours of a mode's map from the low end to the high one, one behind the other. */
function tableOf(mode, name) {
  const key = `${MODES[mode].low} ${name}`;
  if (!tables.has(key)) {
    const all = Array.from({ length: STEPS }, (_, i) => mapped(mapOf(mode, name), i / (STEPS - 1)));
    tables.set(key, Float32Array.from(all.flat()));
  }
  return tables.get(key);
}

/** Some of a tile's numbers that are of something opaque. */
function samplesOf(mode, planes) {
  const numbers = planes[MODES[mode].planes.at(-1)], every = Math.ceil(numbers.length / SAMPLES), found = [];
  for (let i = 0; i < numbers.length; i += every) if (planes.opacity[i] > 0.5) found.push(numbers[i]);
  return found;
}

/** Where most of these numbers lie. */
function rangeOf(mode, samples) {
  if (mode === 'opacity' || !samples.length) return [0, 1];
  const numbers = Float32Array.from(samples).sort();
  const [low, high] = [0.02, 0.98].map(share => numbers[Math.floor(share * (numbers.length - 1))]);
  return [low, Math.max(high, low + 1e-6 * Math.abs(low) + 1e-9)];
}

/** Colours of a tile, 8 bits a channel, by the map of this name where they are of numbers in this range. */
function colours({ mode, map, range: [low, high] }, planes, pixels) {
  if (mode === 'colour') return planes.rgba;
  const made = new Uint8ClampedArray(4 * pixels).fill(255);
  if (mode === 'normals') {
    const { normals } = planes;
    for (let i = 0; i < pixels; i++) {
      const empty = !(normals[3 * i] || normals[3 * i + 1] || normals[3 * i + 2]);
      for (let k = 0; k < 3; k++) made[4 * i + k] = empty ? EMPTY[k] : 127.5 + 127.5 * normals[3 * i + k];
    }
    return made;
  }
  const table = tableOf(mode, map), numbers = planes[MODES[mode].planes.at(-1)], scale = (STEPS - 1) / (high - low);
  for (let i = 0; i < pixels; i++) {
    const at = 3 * Math.max(0, Math.min(STEPS - 1, Math.round((numbers[i] - low) * scale)));
    const opacity = mode === 'opacity' ? 1 : planes.opacity[i];
    for (let k = 0; k < 3; k++) made[4 * i + k] = opacity * table[at + k] + (1 - opacity) * EMPTY[k];
  }
  return made;
}

export { MODES, MODE_NAMES, mapOf, samplesOf, rangeOf, colours };
