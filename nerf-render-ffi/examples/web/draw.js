import { MODES, rangeOf } from './output.js';
import { CLOSED, library, Thread } from './threads.js';
import { add, Orbit, scaled } from './view.js';

/** A frame while the view moves should take this long. */
const MOVING_MS = 60;
/** The view is at rest after this long. */
const REST_MS = 150;
/** Of tiles, in pixels a side; so many for each thread where sizes allow, so that all end at about the same time. */
const MIN_TILE = 32, MAX_TILE = 128, TILES_A_THREAD = 8;
const ANGLE = 40 * Math.PI / 180;
const sleep = milliseconds => new Promise(done => setTimeout(done, milliseconds));

/** Puts a tile on a canvas. */
const put = (context, { rect, rgba }) => context.putImageData(new ImageData(rgba, rect.width, rect.height), rect.x, rect.y);

/** Tiles of a picture for so many threads, of about one size, those in the middle first. */
function tiles(width, height, threads) {
  const side = Math.max(MIN_TILE, Math.min(MAX_TILE, Math.sqrt(width * height / (TILES_A_THREAD * threads))));
  const [across, down] = [width, height].map(length => Math.max(1, Math.round(length / side)));
  const at = (i, of, length) => Math.round(i * length / of), all = [];
  for (let j = 0; j < down; j++) for (let i = 0; i < across; i++) {
    const [x, y] = [at(i, across, width), at(j, down, height)];
    all.push({ x, y, width: at(i + 1, across, width) - x, height: at(j + 1, down, height) - y });
  }
  const off = tile => Math.hypot(tile.x + 0.5 * tile.width - 0.5 * width, tile.y + 0.5 * tile.height - 0.5 * height);
  return all.sort((a, b) => off(a) - off(b));
}

/** A scene on a canvas, drawn by workers: a quick picture for each change, and the full one at rest. */
class Picture {
  /** `tell(name, detail)`: what has happened, `draw` or `error`. `up`: the axis of a scene that does not say. */
  constructor(canvas, { threads, up, tell }) {
    Object.assign(this, { canvas, up, tell, most: threads });
    this.context = canvas.getContext('2d', { alpha: false });
    this.size = [canvas.width, canvas.height];
    /** What is shown of the scene; `range`: null for that of the picture; `crop`: null, or a box. */
    this.look = { mode: 'colour', map: 'viridis', range: null, crop: null };
    this.threads = [];
    /** The scene as the library describes it, and the camera that goes around. */
    this.info = this.view = null;
    /** The camera in place of the one that goes around, of a picture's width and height, or null. */
    this.cover = null;
    /** Whether somebody has moved the view; whether it moves by itself, so that no picture in full is drawn. */
    this.touched = this.flying = false;
    /** Whether the picture in full is shown. */
    this.resting = this.stopped = false;
    /** Milliseconds of each point of the scene's front; of one pixel of a quick picture; both of one thread, as measured last. */
    this.pace = this.pixelMs = null;
    /** The range of the picture that was drawn last, or null where there is none of this mode. */
    this.ownRange = null;
    /** Goes up with everything that changes the picture. */
    this.generation = 0;
    this.changed = () => {};
  }

  /** Opens a scene, or a newer checkpoint of the one there is: then the view stays where somebody has moved it. */
  async open(blob, kernel = this.info?.kernel ?? 'simd128') {
    const module = await library();
    if (this.stopped) throw new Error(CLOSED);
    while (this.threads.length < this.most) this.threads.push(new Thread());
    const [info] = await Promise.all(this.threads.map(thread => thread.ask('open', { module, blob, kernel })));
    const first = !this.info;
    Object.assign(this, { info, pace: null, pixelMs: null });
    if (!this.touched) this.view = await this.home();
    this.change();
    if (first) this.run();
  }

  /** Ends what is under way, and the workers. */
  stop() {
    this.stopped = true;
    for (const thread of this.threads) thread.end();
  }

  change() {
    this.generation += 1;
    this.resting = false;
    this.changed();
  }

  /** Moves the view, unless another camera is in its place. */
  move(action) {
    if (this.cover || !this.view) return;
    action(this.view);
    this.touched = true;
    this.change();
  }

  /** Shows something else of the scene. */
  show(look) {
    Object.assign(this.look, look);
    this.pixelMs = null;
    if (look.mode) this.ownRange = null;
    this.change();
  }

  resize(width, height) {
    if (this.size[0] === width && this.size[1] === height) return;
    // Times measured at another size are not valid at this size.
    Object.assign(this, { size: [width, height], pace: null });
    this.change();
  }

  /** The camera of a picture of this size. */
  camera(width, height) {
    return this.cover ? this.cover(width, height) : this.view.camera(width, height, ANGLE);
  }

  /** The view a scene is first seen from. */
  async home() {
    const { info } = this, [x, y, z] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    if (info.up.some(Boolean) && this.up !== 'y') return Orbit.through(info);
    const distance = 0.5 * (info.near_distance + info.far_distance);
    // Blender's scenes stand on the xy plane.
    const view = this.up === 'y' ? new Orbit(null, distance, y, [z, x]) : new Orbit(null, distance, z, [x, y]);
    view.centre = await this.middle(view);
    return view;
  }

  /** The middle of what is to be seen from four sides of the scene box; the box's own where that is nothing. */
  async middle({ home, up, across }) {
    const centre = scaled(add(this.info.box_min, this.info.box_max), 0.5), side = 24;
    let [sum, weight] = [[0, 0, 0], 0];
    for (let i = 0; i < 4; i++) {
      const from = Object.assign(new Orbit(centre, home, up, across), { azimuth: i * Math.PI / 2 });
      const camera = from.camera(side, side, ANGLE), column = k => [0, 4, 8].map(row => camera.c2w[row + k]);
      const rect = { x: 0, y: 0, width: side, height: side };
      const { planes } = await this.threads[0].ask('render', { camera, rect, planes: MODES.depth.planes });
      planes.opacity.forEach((opacity, pixel) => {
        const [x, y] = [pixel % side + 0.5 - camera.cx, camera.cy - Math.floor(pixel / side) - 0.5];
        const way = add(add(scaled(column(0), x / camera.fx), column(1), y / camera.fy), column(2), -1);
        sum = add(sum, add(column(3), way, planes.z_depth[pixel]), opacity);
        weight += opacity;
      });
    }
    return weight > 1 ? scaled(sum, 1 / weight) : centre;
  }

  /**
   * Draws a picture as it is now to look tile by tile on all threads, which `take` gets as they come, until it is done or not
   * `wanted`. Returns the work and the threads' milliseconds, or null where it was not wanted to the end.
   */
  async frame(width, height, options, take, wanted) {
    const camera = this.camera(width, height), look = { ...this.look, range: this.look.range ?? this.ownRange ?? [0, 1] };
    const left = tiles(width, height, this.threads.length), counters = {};
    let busy = 0, whole = true;
    // Each thread gets its next tile before its current tile is finished.
    await Promise.all([...this.threads, ...this.threads].map(async thread => {
      while (left.length) {
        const rect = left.shift();
        const found = await thread.ask('paint', { camera, options, look, rect });
        if (!wanted()) { whole = false; return; }
        busy += found.milliseconds;
        for (const [name, count] of Object.entries(found.counters)) {
          if (name !== 'struct_size') counters[name] = (counters[name] || 0n) + count;
        }
        take({ rect, rgba: found.planes.rgba, samples: found.samples });
      }
    }));
    return whole ? { counters, busy } : null;
  }

  /** Settings and size of a frame that should take `MOVING_MS`: by the scene's front where it has one, then by size. */
  async quick() {
    const { size: [width, height], threads, pace } = this;
    let options = null, loss = null, expected = this.pixelMs;
    if (pace) {
      const found = await threads[0].ask('within', { milliseconds: MOVING_MS * threads.length, pace });
      loss = found.choice.loss_db;
      options = found.options;
      expected ??= found.choice.milliseconds / (width * height);
    }
    const pixels = expected ? MOVING_MS * threads.length / expected : 0;
    const share = Math.max(1 / 8, Math.min(1, Math.sqrt(pixels / (width * height))));
    return { options, loss, size: [width, height].map(side => Math.max(16, Math.round(share * side))) };
  }

  /** One picture as fast as it must be, whatever happens meanwhile, shown when it is whole; whether it is. */
  async drawQuickly() {
    const { size, canvas, look: { mode }, ownRange } = this, { options, loss, size: [width, height] } = await this.quick();
    const began = performance.now(), tiles = [];
    const { busy } = await this.frame(width, height, options, tile => tiles.push(tile), () => true);
    this.pixelMs = busy / (width * height);
    // The mode may have changed meanwhile.
    if (mode !== this.look.mode) return false;
    if (MODES[mode].unit) {
      this.ownRange = rangeOf(mode, tiles.flatMap(({ samples }) => samples));
      // The first picture of a mode is drawn again, with the range that is known now.
      if (!ownRange) return false;
    }
    const small = new OffscreenCanvas(width, height), ink = small.getContext('2d', { alpha: false });
    for (const tile of tiles) put(ink, tile);
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    this.context.drawImage(small, 0, 0, ...size);
    this.tell('draw', { full: false, width, height, milliseconds: performance.now() - began, loss });
    return true;
  }

  /** The picture in full, unless the view changes meanwhile: tile by tile, or at once for who wants little to move. */
  async drawFully(now) {
    const { planes } = MODES[this.look.mode], [width, height] = this.size;
    const calm = matchMedia('(prefers-reduced-motion: reduce)').matches, began = performance.now(), tiles = [];
    const done = await this.frame(width, height, null, tile => calm ? tiles.push(tile) : put(this.context, tile),
      () => this.generation === now);
    if (!done) return;
    for (const tile of tiles) put(this.context, tile);
    this.tell('draw', { full: true, width, height, milliseconds: performance.now() - began, planes, ...done });
  }

  /** How long the scene's front takes: measured at rest, since nothing else may run; it decides the next quick picture. */
  async measure(now) {
    const [width, height] = this.size, limit = 4 * MOVING_MS * this.threads.length;
    const found = await this.threads[0].ask('pace',
      { camera: this.camera(width, height), planes: MODES.colour.planes, limit });
    // Size or kernel may have changed meanwhile.
    if (this.generation === now) Object.assign(this, { pace: found, pixelMs: null });
  }

  /** The whole life of a picture. */
  async run() {
    try {
      for (;;) {
        const now = this.generation;
        const next = new Promise(resolve => { this.changed = resolve; });
        if (!await this.drawQuickly()) continue;
        await Promise.race([next, sleep(REST_MS)]);
        if (this.generation !== now || this.flying) continue;
        await this.drawFully(now);
        if (this.generation === now && this.info.front_points && !this.pace) await this.measure(now);
        if (this.generation !== now) continue;
        this.resting = true;
        await next;
      }
    } catch (error) {
      this.tell('error', error);
    }
  }
}

export { ANGLE, Picture, sleep };
