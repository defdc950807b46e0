
/** Steps between two keyframes at which the flight is measured. */
const PIECES = 32;
const FPS = 24;

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

const dot = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);
const placeOf = pose => [pose[3], pose[7], pose[11]];

/**
 * A smooth flight through poses at constant speed, as `nerf-train render --keyframes` makes: a Catmull-Rom spline through
 * places and turns; a right angle is as long a way as the mean distance of two poses. A function of 0 to 1.
 */
function flight(poses) {
  if (poses.length < 2) return () => poses[0];
  const places = poses.map(placeOf), turns = [];
  for (const pose of poses) {
    const turn = turnOf(pose), last = turns.at(-1);
    turns.push(last && dot(last, turn) < 0 ? scaled(turn, -1) : turn);
  }
  const spans = poses.length - 1;
  const mean = places.slice(1).reduce((sum, p, i) => sum + Math.hypot(...add(p, places[i], -1)), 0) / spans;
  const radius = Math.max(mean, 1e-6) / (Math.PI / 2);
  const at = where => {
    const first = Math.min(Math.floor(where), poses.length - 2), t = where - first;
    const weights = [0.5 * t * (t * (2 - t) - 1), 0.5 * (t * t * (3 * t - 5) + 2), 0.5 * t * (t * (4 - 3 * t) + 1),
      0.5 * t * t * (t - 1)];
    const index = i => Math.max(0, Math.min(poses.length - 1, first + i - 1));
    const mix = all => weights.reduce((sum, weight, i) => add(sum, all[index(i)], weight), all[0].map(() => 0));
    return { place: mix(places), turn: unit(mix(turns)) };
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
    const { place, turn } = at((piece - 1 + (to > from ? (way - from) / (to - from) : 0)) / PIECES);
    return poseOf(turn, place);
  };
}

/** nerfstudio's camera_path.json of a flight, which `nerf-train render --path` reads; `fov`: vertical, degrees. */
function pathFile(poses, seconds, [width, height], fov) {
  const frames = poses.length < 2 ? 1 : Math.max(2, Math.round(seconds * FPS)), along = flight(poses);
  const frame = i => ({
    camera_to_world: [...along(frames < 2 ? 0 : i / (frames - 1)), 0, 0, 0, 1], fov, aspect: width / height,
  });
  return {
    camera_type: 'perspective', render_width: width, render_height: height, fps: FPS, seconds: frames / FPS,
    camera_path: Array.from({ length: frames }, (_, i) => frame(i)),
  };
}
