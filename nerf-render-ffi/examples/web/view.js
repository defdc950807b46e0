const add = (a, b, s = 1) => a.map((x, i) => x + s * b[i]);
const scaled = (a, s) => a.map(x => s * x);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const dot = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);
const unit = a => scaled(a, 1 / Math.hypot(...a));

/** A `nerf_camera` without distortion, its focal length in pixels. */
const cameraOf = (c2w, width, height, focal) =>
  ({ width, height, fx: focal, fy: focal, cx: 0.5 * width, cy: 0.5 * height, c2w });

/** The same camera with pictures of another size. */
function resized(camera, width, height) {
  const [x, y] = [width / camera.width, height / camera.height];
  return { ...camera, width, height, fx: x * camera.fx, cx: x * camera.cx, fy: y * camera.fy, cy: y * camera.cy };
}

/** A camera that goes around a point; angles in radians, distance in world units. */
class Orbit {
  /** `across`: two axes in the plane of the ground, right-handed with `up`. */
  constructor(centre, distance, up, across, start = { azimuth: -0.9, elevation: 0.45 }) {
    Object.assign(this, { centre, home: distance, up, across, start });
    this.reset();
  }

  /** Begins where the photographs were taken, as the scene says. */
  static through({ eye, target, up }) {
    const from = add(eye, target, -1), height = dot(from, up), flat = add(from, up, -height), across = Math.hypot(...flat);
    const side = across > 0 ? scaled(flat, 1 / across) : unit(cross(up, Math.abs(up[0]) < 0.5 ? [1, 0, 0] : [0, 1, 0]));
    const start = { azimuth: 0, elevation: Math.max(-1.5, Math.min(1.5, Math.atan2(height, across))) };
    return new Orbit(target, Math.hypot(...from), up, [side, cross(up, side)], start);
  }

  reset() {
    Object.assign(this, { ...this.start, distance: this.home });
  }

  turn(dx, dy) {
    this.azimuth -= 0.008 * dx;
    this.elevation = Math.max(-1.5, Math.min(1.5, this.elevation + 0.008 * dy));
  }

  dolly(factor) {
    this.distance = Math.max(0.1 * this.home, Math.min(4 * this.home, this.distance * factor));
  }

  /** From the centre to the eye, unit length. */
  backward() {
    const flat = add(scaled(this.across[0], Math.cos(this.azimuth)), this.across[1], Math.sin(this.azimuth));
    return add(scaled(flat, Math.cos(this.elevation)), this.up, Math.sin(this.elevation));
  }

  /** Where it is seen from. */
  inWords() {
    const degrees = angle => Math.round(angle * 180 / Math.PI), turned = degrees(this.azimuth - this.start.azimuth);
    return `turned by ${(turned % 360 + 360) % 360} degrees, from ${degrees(this.elevation)} degrees above, at ` +
      `${Math.round(100 * this.distance / this.home)} percent of the first distance`;
  }

  /** Rows of the camera-to-world matrix. */
  pose() {
    const backward = this.backward();
    const right = unit(cross(this.up, backward));
    const top = cross(backward, right);
    const eye = add(this.centre, backward, this.distance);
    return [0, 1, 2].flatMap(i => [right[i], top[i], backward[i], eye[i]]);
  }

  /** A `nerf_camera` of this size, whose shorter side sees `angle`. */
  camera(width, height, angle) {
    return cameraOf(this.pose(), width, height, 0.5 * Math.min(width, height) / Math.tan(0.5 * angle));
  }
}

export { add, scaled, dot, unit, cameraOf, resized, Orbit };
