
/** What is shown: planes of each mode (what is not among them is not computed), and what its numbers are. */
const MODES = {
  colour: { planes: ['rgb'] },
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

/** A colour map at a share of its length. */
function mapped(map, share) {
  const at = Math.max(0, Math.min(1, share)) * (map.length - 1), left = Math.min(map.length - 2, Math.floor(at));
  return add(map[left], add(map[left + 1], map[left], -1), at - left);
}

/** The map of a mode: what is near is bright. */
const mapOf = (mode, name) => MODES[mode].low === 'near' ? [...MAPS[name]].reverse() : MAPS[name];

/** Colours of pixels, 8 bits a channel. */
function colours(mode, planes, pixels, map, [low, high]) {
  const made = new Uint8ClampedArray(4 * pixels);
  const numbers = planes[MODES[mode].planes.at(-1)];
  for (let i = 0; i < pixels; i++) {
    let colour;
    if (mode === 'normals') {
      const normal = [0, 1, 2].map(k => planes.normals[3 * i + k]);
      colour = normal.every(x => x === 0) ? EMPTY : normal.map(x => 127.5 + 127.5 * x);
    } else if (mode === 'colour') {
      colour = [0, 1, 2].map(k => Math.floor(255 * Math.max(0, Math.min(1, planes.rgb[3 * i + k])) + 0.5));
    } else {
      colour = mapped(map, (numbers[i] - low) / (high - low));
      if (mode !== 'opacity') colour = add(scaled(colour, planes.opacity[i]), EMPTY, 1 - planes.opacity[i]);
    }
    made.set(colour, 4 * i);
    made[4 * i + 3] = 255;
  }
  return made;
}
