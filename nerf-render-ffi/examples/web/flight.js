/** Steps between two keyframes at which the flight is measured. */
const PIECES = 32;
const FPS = 24;
/** Of a saved path: more than an hour, as much as `nerf-train` reads. */
const MAX_FRAMES = 100_000;

/** The unit quaternion (x, y, z, w) of a pose. */
function turnOf(m) {
  const [a, b, c, d, e, f, g, h, i] = [0, 1, 2, 4, 5, 6, 8, 9, 10].map(k => m[k]);
  const trace = a + e + i;
  const q = trace > 0 ? [h - f, c - g, d - b, 1 + trace]
    : a > e && a > i ? [1 + a - e - i, b + d, c + g, h - f]
      : e > i ? [b + d, 1 + e - a - i, f + h, c - g] : [c + g, f + h, 1 + i - a - e, d - b];
  return unit(q);
}

/** The pose of a place and a quaternion. */
function poseOf([x, y, z, w], [px, py, pz]) {
  return [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), px,
    2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), py,
    2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), pz];
}

const placeOf = pose => [pose[3], pose[7], pose[11]];

/**
 * A smooth flight through keyframes at constant speed, as `nerf-train render --keyframes` makes: a Catmull-Rom spline
 * through places and turns; a right angle is as long a way as the mean distance of two poses. Fields of view are
 * interpolated by the logarithm of the focal length. A function of 0 to 1.
 */
function flight(views) {
  if (views.length < 2) return () => views[0];
  const places = views.map(({ pose }) => placeOf(pose)), turns = [];
  for (const { pose } of views) {
    const turn = turnOf(pose), last = turns.at(-1);
    turns.push(last && dot(last, turn) < 0 ? scaled(turn, -1) : turn);
  }
  const zooms = views.map(({ fov }) => Math.log(Math.tan(0.5 * fov)));
  const spans = views.length - 1;
  const mean = places.slice(1).reduce((sum, p, i) => sum + Math.hypot(...add(p, places[i], -1)), 0) / spans;
  const radius = Math.max(mean, 1e-6) / (Math.PI / 2);
  const at = where => {
    const first = Math.min(Math.floor(where), spans - 1), t = where - first;
    const weights = [0.5 * t * (t * (2 - t) - 1), 0.5 * (t * t * (3 * t - 5) + 2), 0.5 * t * (t * (4 - 3 * t) + 1),
      0.5 * t * t * (t - 1)];
    const index = i => Math.max(0, Math.min(spans, first + i - 1));
    const mix = all => weights.reduce((sum, weight, i) => add(sum, all[index(i)], weight), all[0].map(() => 0));
    const zoom = (1 - t) * zooms[first] + t * zooms[first + 1];
    return { place: mix(places), turn: unit(mix(turns)), fov: 2 * Math.atan(Math.exp(zoom)) };
  };
  const ways = [0];
  for (let i = 1, last = at(0); i <= spans * PIECES; i++) {
    const next = at(i / PIECES), angle = 2 * Math.acos(Math.min(1, Math.abs(dot(last.turn, next.turn))));
    ways.push(ways[i - 1] + Math.hypot(...add(next.place, last.place, -1)) + radius * angle);
    last = next;
  }
  return share => {
    const way = Math.max(0, Math.min(1, share)) * ways.at(-1);
    const piece = Math.max(1, ways.findIndex((w, i) => i > 0 && w >= way)), [from, to] = [ways[piece - 1], ways[piece]];
    const { place, turn, fov } = at((piece - 1 + (to > from ? (way - from) / (to - from) : 0)) / PIECES);
    return { pose: poseOf(turn, place), fov };
  };
}

/** What a blob's coordinates count from in those of its data, whose name states it where that is not 0. */
function originIn(name) {
  const stated = name.match(/, origin at \((-?[\d.]+), (-?[\d.]+), (-?[\d.]+)\)$/);
  return stated ? stated.slice(1).map(Number) : [0, 0, 0];
}

/**
 * nerfstudio's camera_path.json of a flight, in the coordinates of the data: `camera_path` is what is rendered,
 * `keyframes` what nerfstudio's viewer loads. It says no `default_fov`, for which the viewer would take its own.
 */
function pathFile(views, seconds, [width, height], origin) {
  const frames = views.length < 2 ? 1 : Math.max(2, Math.min(MAX_FRAMES, Math.round(seconds * FPS)));
  const along = flight(views), duration = frames / FPS;
  const camera = ({ pose, fov }, matrix) => ({
    [matrix]: [...pose.map((x, i) => i % 4 === 3 ? x + origin[(i - 3) / 4] : x), 0, 0, 0, 1],
    fov: fov * 180 / Math.PI, aspect: width / height,
  });
  return {
    camera_type: 'perspective', render_width: width, render_height: height, fps: FPS, seconds: duration,
    default_transition_sec: duration / Math.max(1, views.length - 1),
    keyframes: views.map(view => camera(view, 'matrix')),
    camera_path: Array.from({ length: frames }, (_, i) => camera(along(i / Math.max(1, frames - 1)), 'camera_to_world')),
  };
}

/** To fly through: `{ pose, fov }`, the vertical field of view in radians. */
const keyframes = [];

function tellKeyframes() {
  const count = keyframes.length;
  element('keyframes').textContent = `${count} keyframe${count === 1 ? '' : 's'}`;
  for (const id of ['save', 'clear']) element(id).disabled = !count;
  element('preview').disabled = count < 2;
}

const flightSeconds = () => Math.max(0.1, Number(element('seconds').value) || 4);

/** Shows the flight in its own time, as many frames of it as there is time for; to who wants little to move, the keyframes. */
async function preview() {
  if (keyframes.length < 2 || flying) return;
  const along = flight(keyframes), seconds = flightSeconds(), began = performance.now();
  const calm = matchMedia('(prefers-reduced-motion: reduce)').matches, last = keyframes.length - 1;
  flying = along(0);
  tellPhotograph();
  for (let share = 0, shown = 0; ; shown++) {
    flying = calm ? keyframes[Math.floor(share * last)] : along(share);
    const next = new Promise(resolve => scene.addEventListener('draw', resolve, { once: true }));
    cover();
    await next;
    body.dataset.flown = shown + 1;
    if (share === 1) break;
    if (calm) await sleep(1000 * seconds / last);
    share = calm ? (shown + 1) / last : Math.min(1, (performance.now() - began) / 1000 / seconds);
  }
  flying = null;
  tellPhotograph();
  cover();
}

/** The flight as a file. */
const pathNow = () =>
  pathFile(keyframes, flightSeconds(), picture.size, originIn(picture.info.data));

function save() {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(new Blob([JSON.stringify(pathNow())], { type: 'application/json' }));
  link.download = 'camera_path.json';
  link.click();
  URL.revokeObjectURL(link.href);
}
