'use strict';
// Vectors are arrays [x, y, z] in world units.
const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/** A viewpoint that orbits a target; up stays up. Angles in radians, pixels are CSS pixels. */
class View {
  constructor(up, across) {
    Object.assign(this, { up, across, target: [0, 0, 0], distance: 1, azimuth: 0, elevation: 0.4 });
    this.resize(1, 1);
  }
  resize(width, height) {
    this.width = width;
    this.height = height;
    /** Where the target is, pixels from the left. */
    this.middle = 0.5 * width;
    // 32 degrees from top to bottom.
    this.focal = 0.5 * height / Math.tan(16 * Math.PI / 180);
    this.update();
  }
  /** The direction from the target to the eye, and the picture's right and up. */
  update() {
    const { azimuth: a, elevation: e } = this;
    const flat = add(scaled(this.across[0], Math.cos(a)), this.across[1], Math.sin(a));
    this.backward = add(scaled(flat, Math.cos(e)), this.up, Math.sin(e));
    this.right = add(scaled(this.across[0], -Math.sin(a)), this.across[1], Math.cos(a));
    this.above = cross(this.backward, this.right);
    this.eye = add(this.target, this.backward, this.distance);
    this.near = 0.01 * this.distance;
  }
  /** World-to-eye as 3 rows of 4. */
  matrix() {
    return [this.right, this.above, this.backward].flatMap(row => [...row, -dot(row, this.eye)]);
  }
  lookFrom(towards) {
    this.azimuth = Math.atan2(dot(towards, this.across[1]), dot(towards, this.across[0]));
    this.elevation = Math.asin(Math.max(-1, Math.min(1, dot(towards, this.up))));
    this.update();
  }
  turn(dx, dy) {
    const limit = Math.PI / 2;
    this.azimuth -= 0.008 * dx;
    this.elevation = Math.max(-limit, Math.min(limit, this.elevation + 0.008 * dy));
    this.update();
  }
  move(dx, dy) {
    const size = this.distance / this.focal;
    this.target = add(add(this.target, this.right, -dx * size), this.above, dy * size);
    this.update();
  }
  zoom(factor) {
    this.distance = Math.max(this.closest, Math.min(this.furthest, this.distance * factor));
    this.update();
  }
  /** Right, up and depth. */
  toEye(p) {
    const d = add(p, this.eye, -1);
    return [dot(d, this.right), dot(d, this.above), -dot(d, this.backward)];
  }
  ofEye([x, y, z]) {
    return [this.middle + x / z * this.focal, 0.5 * this.height - y / z * this.focal, z];
  }
  /** [x, y, depth] in pixels, or null behind the near plane. */
  project(p) {
    const eye = this.toEye(p);
    return eye[2] >= this.near ? this.ofEye(eye) : null;
  }
  /** Both ends of the part in front of the near plane, or null. */
  segment(a, b) {
    const [p, q] = [this.toEye(a), this.toEye(b)];
    if (Math.max(p[2], q[2]) < this.near) return null;
    const cut = (p, q) => p[2] >= this.near ? p : add(p, add(q, p, -1), (this.near - p[2]) / (q[2] - p[2]));
    return [this.ofEye(cut(p, q)), this.ofEye(cut(q, p))];
  }
  /** As near as all points fit in, left of `margin` pixels at the right edge. */
  fit(points, margin) {
    const low = [0, 1, 2].map(i => Math.min(...points.map(p => p[i])));
    const high = [0, 1, 2].map(i => Math.max(...points.map(p => p[i])));
    this.target = scaled(add(low, high), 0.5);
    const radius = Math.max(1e-6, ...points.map(p => Math.hypot(...add(p, this.target, -1))));
    const width = Math.max(0.4 * this.width, this.width - margin);
    const half = [0.46 * width / this.focal, 0.46 * this.height / this.focal];
    this.middle = 0.5 * width;
    this.closest = 0.02 * radius;
    this.furthest = 50 * radius;
    this.distance = radius / Math.sin(Math.atan(Math.min(...half)));
    for (let i = 0; i < 24; i++) {
      this.update();
      const eyes = points.map(p => this.toEye(p)).filter(p => p[2] > 0);
      const range = [0, 1].map(k => eyes.map(p => p[k] / p[2])).map(v => [Math.min(...v), Math.max(...v)]);
      const middle = range.map(([a, b]) => 0.5 * (a + b) * this.distance);
      this.target = add(add(this.target, this.right, middle[0]), this.above, middle[1]);
      const filled = Math.max(...range.map(([a, b], k) => 0.5 * (b - a) / half[k]));
      this.distance = Math.max(1.02 * radius, this.distance * (0.5 + 0.5 * filled));
    }
    this.update();
  }
}
