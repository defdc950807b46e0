/** A C type of wasm32: bytes, and what a DataView calls it. */
const TYPES = {
  u32: [4, 'Uint32'], f32: [4, 'Float32'], u64: [8, 'BigUint64'], size: [4, 'Uint32'], pointer: [4, 'Uint32'],
};

/** Structures of include/nerf_render.h, as `name: type`, `[type, count]` or `[structure, count]`. */
const STRUCTURES = {};

/** Lays the fields of a structure out as C does. */
function structure(name, fields) {
  const made = { size: 0, align: 4, fields: {} };
  for (const [field, type] of Object.entries(fields)) {
    const [of, count] = Array.isArray(type) ? type : [type, 1];
    const inner = STRUCTURES[of];
    const [size, align] = inner ? [inner.size, inner.align] : [TYPES[of][0], TYPES[of][0]];
    const at = Math.ceil(made.size / align) * align;
    made.fields[field] = { at, of, size, count, many: Array.isArray(type) };
    made.size = at + size * count;
    made.align = Math.max(made.align, align);
  }
  made.size = Math.ceil(made.size / made.align) * made.align;
  STRUCTURES[name] = made;
}

structure('nerf_open_options', { struct_size: 'size', kernel: 'u32', storage: 'u32', reserved: ['u32', 6] });
structure('nerf_text', { data: 'pointer', length: 'size' });
structure('nerf_scene_info', {
  struct_size: 'size', kind: 'u32', kernel: 'u32', box_min: ['f32', 3], box_max: ['f32', 3],
  near_distance: 'f32', far_distance: 'f32', samples: 'u32', background: ['f32', 3], view_dependent: 'u32',
  occupancy_required: 'u32', occupancy_resolution: ['u32', 3], occupied_share: 'f32', trunk_layers: 'u32',
  trunk_widths: ['u32', 16], colour_layers: 'u32', colour_widths: ['u32', 4], psnr_db: 'f32',
  quantisation_loss_db: 'f32', steps: 'u32', parameters: 'u64', density_macs: 'u64', colour_macs: 'u64',
  seed: 'u64', data: 'nerf_text', made_by: 'nerf_text', psnr_convention: 'nerf_text', picture_width: 'u32',
  picture_height: 'u32', proposal_samples: 'u32', front_points: 'u32', proposal_macs: 'u64',
  step: 'f32', table_storage: 'u32', contraction_radius: 'f32', contraction_power: 'u32',
  storage: 'u32', eye: ['f32', 3], target: ['f32', 3], up: ['f32', 3], arc: 'f32',
});
structure('nerf_camera', {
  struct_size: 'size', width: 'u32', height: 'u32', fx: 'f32', fy: 'f32', cx: 'f32', cy: 'f32', k1: 'f32',
  k2: 'f32', p1: 'f32', p2: 'f32', c2w: ['f32', 12], k3: 'f32', k4: 'f32', k5: 'f32',
  k6: 'f32', lens_model: 'u32', reserved: 'u32',
});
structure('nerf_effects', {
  jitter: 'u32', anti_aliasing: 'u32', seed: 'u64', aperture_radius: 'f32', focus_distance: 'f32',
  exposure: 'f32', tone_map: 'u32', linear: 'u32', reserved: ['u32', 5],
});
structure('nerf_render_options', {
  struct_size: 'size', samples: 'u32', transmittance_cut: 'f32', ignore_occupancy: 'u32', maths: 'u32',
  background_set: 'u32', background: ['f32', 3], batch_rays: 'u32', batch_samples: 'u32', colour_cut: 'f32',
  normal_blur: 'f32', ignore_proposal: 'u32', near_distance: 'f32', far_distance: 'f32',
  own_bins: 'u32', reserved: 'u32', effects: 'nerf_effects',
});
structure('nerf_request', {
  struct_size: 'size', scene: 'pointer', instances: 'pointer', instance_count: 'size', options: 'pointer',
  outputs: 'u32', reserved: 'u32',
});
structure('nerf_plane', { data: 'pointer', pixel_stride: 'size', row_stride: 'size', format: 'u32', reserved: 'u32' });
structure('nerf_target', {
  struct_size: 'size', rgb: 'nerf_plane', opacity: 'nerf_plane', ray_distance: 'nerf_plane',
  z_depth: 'nerf_plane', median_distance: 'nerf_plane', normals: 'nerf_plane', limit_ray_distance: 'nerf_plane',
  limit_z_depth: 'nerf_plane',
});
structure('nerf_rect', { x: 'u32', y: 'u32', width: 'u32', height: 'u32' });
structure('nerf_frame', {
  struct_size: 'size', camera: 'pointer', rect: 'pointer', target: 'pointer', width: 'u32', height: 'u32',
  progress: 'pointer', user: 'pointer',
});
structure('nerf_floats', { data: 'pointer', stride: 'size' });
structure('nerf_rays', {
  struct_size: 'size', count: 'size', origins: 'nerf_floats', dirs: 'nerf_floats', t_min: 'nerf_floats',
  t_max: 'nerf_floats', random: 'nerf_floats', axis: 'pointer', target: 'pointer',
});
structure('nerf_counters', {
  struct_size: 'size', rays: 'u64', samples_kept: 'u64', samples_skipped: 'u64', density_evaluations: 'u64',
  colour_evaluations: 'u64', macs: 'u64', invalid_samples: 'u64', normal_evaluations: 'u64',
  proposal_evaluations: 'u64',
});
structure('nerf_choice', { struct_size: 'size', loss_db: 'f32', cost: 'f32', milliseconds: 'f32', within: 'u32' });
structure('nerf_pace_request', {
  struct_size: 'size', scene: 'pointer', camera: 'pointer', options: 'pointer', outputs: 'u32',
  limit_milliseconds: 'f32', clock: 'pointer', user: 'pointer',
});
structure('nerf_pace', { struct_size: 'size', milliseconds: ['f32', 16] });

const KERNELS = ['auto', 'portable', 'avx2', 'avx512', 'simd128', 'neon'];
const FORMAT_RGB_U8 = 1, FORMAT_RGB_F32 = 2, FORMAT_F32 = 5, FORMAT_VEC3_F32 = 6;
/** Planes of a target: the bit of `NERF_OUTPUT_*`, the format, and words of a pixel; `rgba`: `rgb` as a canvas takes it. */
const PLANES = {
  rgba: [1, FORMAT_RGB_U8, 1], rgb: [1, FORMAT_RGB_F32, 3], opacity: [2, FORMAT_F32, 1], ray_distance: [4, FORMAT_F32, 1],
  z_depth: [8, FORMAT_F32, 1], median_distance: [16, FORMAT_F32, 1], normals: [32, FORMAT_VEC3_F32, 3],
};
const outputsOf = planes => planes.reduce((bits, name) => bits | PLANES[name][0], 0);

/** A module `(import "h" "f" (func (param i32) (result i64))) (export "f")`: JavaScript in C's function table. */
const CLOCK_TYPE = Uint8Array.of(
  0, 97, 115, 109, 1, 0, 0, 0, 1, 6, 1, 96, 1, 127, 1, 126, 2, 7, 1, 1, 104, 1, 102, 0, 0, 7, 5, 1, 1, 102, 0, 0);

/** An instance of the library and the memory it works in, all of which is handed out here, from `__heap_base` on. */
class Library {
  constructor(module) {
    const nerf_panicked = () => { throw new Error('the library panicked'); };
    this.exports = new WebAssembly.Instance(module, { env: { nerf_panicked } }).exports;
    this.top = this.exports.__heap_base.value;
    this.rooms = {};
    this.message = this.place(512);
    this.out = this.place(16);
  }

  get memory() { return this.exports.memory.buffer; }

  /** The address of new memory, for as long as the instance lives. */
  place(size, align = 64) {
    const at = Math.ceil(this.top / align) * align;
    const missing = at + size - this.memory.byteLength;
    if (missing > 0) this.exports.memory.grow(Math.ceil(missing / 65536)); // may throw, and then nothing is placed
    this.top = at + size;
    return at;
  }

  /** Memory of at least this size under a name, which forgets what was there. */
  room(name, size) {
    const room = this.rooms[name];
    if (room && room.size >= size) return room.at;
    this.rooms[name] = { at: this.place(size), size };
    return this.rooms[name].at;
  }

  /** Writes `values` at an address; numbers, arrays of numbers, or objects for structures. */
  write(name, at, values) {
    const view = new DataView(this.memory);
    for (const [field, value] of Object.entries(values)) {
      const { at: offset, of, size, count, many } = STRUCTURES[name].fields[field];
      for (let i = 0; i < count; i++) {
        const one = many ? value[i] : value, place = at + offset + i * size;
        if (STRUCTURES[of]) this.write(of, place, one); else view[`set${TYPES[of][1]}`](place, one, true);
      }
    }
  }

  /** A structure at an address of its own, zeroed but for its size and `values`. */
  structure(name, values = {}) {
    const { size, fields } = STRUCTURES[name];
    const at = this.room(name, size);
    new Uint8Array(this.memory, at, size).fill(0);
    this.write(name, at, fields.struct_size ? { struct_size: size, ...values } : values);
    return at;
  }

  /** The structure at an address. */
  read(name, at) {
    const view = new DataView(this.memory);
    const one = (of, place) => STRUCTURES[of] ? this.read(of, place) : view[`get${TYPES[of][1]}`](place, true);
    const entries = Object.entries(STRUCTURES[name].fields).map(([field, { at: offset, of, size, count, many }]) => {
      const all = Array.from({ length: count }, (_, i) => one(of, at + offset + i * size));
      return [field, many ? all : all[0]];
    });
    return Object.fromEntries(entries);
  }

  /** The two sizes that a query wrote to `out`. */
  answer() { return new Uint32Array(this.memory, this.out, 2); }

  text(at, length) { return new TextDecoder().decode(new Uint8Array(this.memory, at, length)); }

  /** Calls a function whose last arguments are the message buffer; throws what the library says. */
  call(name, ...more) {
    const status = this.exports[name](...more, this.message, 512);
    if (status === 0) return;
    const bytes = new Uint8Array(this.memory, this.message, 512);
    throw new Error(this.text(this.message, bytes.indexOf(0)) || `${name}: status ${status}`);
  }

  /** A function of the page as a `nerf_clock`. */
  clock(microseconds) {
    const made = new WebAssembly.Instance(new WebAssembly.Module(CLOCK_TYPE), { h: { f: microseconds } });
    const table = this.exports.__indirect_function_table;
    const at = table.grow(1);
    table.set(at, made.exports.f);
    return at;
  }
}

/** What bends the rays of a `nerf_camera`. */
const LENS = ['k1', 'k2', 'k3', 'k4', 'k5', 'k6', 'p1', 'p2', 'lens_model'];

/**
 * The ray through an image point of a camera without a lens, as a function: `nerf_camera_ray` bit for bit, since each step
 * is rounded to a float. What it returns is overwritten by the next.
 */
function pinholeOf(camera) {
  const { fround } = Math, ray = { origin: new Float32Array(3), dir: new Float32Array(3) };
  const [fx, fy, cx, cy, ...m] = [camera.fx, camera.fy, camera.cx, camera.cy, ...camera.c2w].map(fround);
  ray.origin.set([m[3], m[7], m[11]]);
  const { dir } = ray;
  return (x, y) => {
    const u = fround(fround(x - cx) / fx), v = fround(fround(y - cy) / fy);
    for (let i = 0; i < 3; i++) dir[i] = fround(fround(m[4 * i] * u) - fround(m[4 * i + 1] * v)) - m[4 * i + 2];
    const square = fround(fround(dir[0] * dir[0]) + fround(dir[1] * dir[1])) + fround(dir[2] * dir[2]);
    const scale = fround(1 / fround(Math.sqrt(fround(square))));
    for (let i = 0; i < 3; i++) dir[i] *= scale;
    return ray;
  };
}

/** An opened scene, with one worker. */
class Scene {
  constructor(module, blob, kernel) {
    const library = this.library = new Library(module);
    const at = library.place(blob.byteLength);
    new Uint8Array(library.memory).set(blob, at);
    const options = library.structure('nerf_open_options', { kernel: KERNELS.indexOf(kernel) });
    library.call('nerf_scene_memory', at, blob.byteLength, options, library.out, library.out + 4);
    const size = library.answer()[0];
    const memory = library.place(size);
    library.call('nerf_scene_open', at, blob.byteLength, options, memory, size, library.out);
    this.handle = library.answer()[0];
  }

  describe() {
    const { library } = this;
    const at = library.structure('nerf_scene_info');
    const status = library.exports.nerf_scene_describe(this.handle, at);
    if (status) throw new Error(`nerf_scene_describe: status ${status}`);
    const info = library.read('nerf_scene_info', at);
    for (const name of ['data', 'made_by', 'psnr_convention']) info[name] = library.text(info[name].data, info[name].length);
    return { ...info, kernel: KERNELS[info.kernel] };
  }

  /** The worker for options (null: the defaults) and planes: the one there is, or another in its place. */
  worker(options, planes) {
    const { library } = this, outputs = outputsOf(planes);
    const settings = library.structure('nerf_render_options', options ?? {});
    const bytes = new Uint8Array(library.memory, settings, STRUCTURES.nerf_render_options.size);
    const key = `${outputs}: ${bytes}`;
    if (this.opened?.key === key) return this.opened.worker;
    this.opened = null;
    const request = library.structure('nerf_request', { scene: this.handle, options: settings, outputs });
    library.call('nerf_worker_size', request, library.out, library.out + 4);
    const size = library.answer()[0];
    library.call('nerf_worker_open', request, library.room('worker', size), size, library.out);
    this.opened = { key, worker: library.answer()[0] };
    return this.opened.worker;
  }

  /** Memory for planes of so many pixels: the fields of a target, and how to read them. */
  planes(names, pixels) {
    const { library } = this;
    const at = names.map(name => library.room(name, 4 * pixels * PLANES[name][2]));
    const read = (name, i) => name === 'rgba' ? new Uint8ClampedArray(library.memory, at[i], 4 * pixels).slice()
      : new Float32Array(library.memory, at[i], pixels * PLANES[name][2]).slice();
    const field = (name, i) => name === 'rgba' ? ['rgb', { data: at[i], format: FORMAT_RGB_U8, pixel_stride: 4 }]
      : [name, { data: at[i], format: PLANES[name][1] }];
    // Alpha is 255 in every pixel: the library writes only the three bytes in front of alpha.
    const rgba = names.indexOf('rgba');
    if (rgba >= 0) new Uint8Array(library.memory, at[rgba], 4 * pixels).fill(255);
    return {
      fields: Object.fromEntries(names.map(field)),
      read: () => Object.fromEntries(names.map((name, i) => [name, read(name, i)])),
    };
  }

  /** Floats of the page's, copied to where the library reads them; their address. */
  floats(name, values) {
    const at = this.library.room(name, 4 * values.length);
    new Float32Array(this.library.memory, at, values.length).set(values);
    return at;
  }

  /**
   * Renders a rectangle; its planes as floats, and the work. `limits`: null, or `limit_ray_distance` or `limit_z_depth` with a
   * float for each of its pixels, where their rays end.
   */
  render({ camera, options = null, rect, planes, limits = null }) {
    const { library } = this;
    const worker = this.worker(options, planes), to = this.planes(planes, rect.width * rect.height);
    const ends = Object.entries(limits ?? {}).map(([name, values]) =>
      [name, { data: this.floats(name, values), format: FORMAT_F32 }]);
    const counters = library.structure('nerf_counters');
    const frame = library.structure('nerf_frame', {
      camera: library.structure('nerf_camera', camera), rect: library.structure('nerf_rect', rect),
      target: library.structure('nerf_target', { ...to.fields, ...Object.fromEntries(ends) }),
    });
    library.call('nerf_render', worker, frame, counters);
    return { planes: to.read(), counters: library.read('nerf_counters', counters) };
  }

  /** What rays of the page's own see: `origins`, `dirs` three floats each, `t_min`, `t_max` null or one each; `axis` for z_depth. */
  rays({ origins, dirs, t_min = null, t_max = null, axis = null, options = null, planes }) {
    const { library } = this, count = origins.length / 3;
    const worker = this.worker(options, planes), to = this.planes(planes, count);
    const counters = library.structure('nerf_counters');
    const rays = library.structure('nerf_rays', {
      count, origins: { data: this.floats('origins', origins), stride: 0 },
      dirs: { data: this.floats('dirs', dirs), stride: 0 },
      t_min: { data: t_min ? this.floats('t_min', t_min) : 0, stride: 0 },
      t_max: { data: t_max ? this.floats('t_max', t_max) : 0, stride: 0 },
      axis: axis ? this.floats('axis', axis) : 0, target: library.structure('nerf_target', to.fields),
    });
    library.call('nerf_render_rays', worker, rays, counters);
    return { planes: to.read(), counters: library.read('nerf_counters', counters) };
  }

  /** The ray through an image point of a camera. */
  cameraRay(camera, x, y) {
    const { library } = this, at = library.room('ray', 24);
    library.call('nerf_camera_ray', library.structure('nerf_camera', camera), x, y, at, at + 12, 0);
    const floats = new Float32Array(library.memory, at, 6).slice();
    return { origin: floats.subarray(0, 3), dir: floats.subarray(3) };
  }

  /** The rays of a camera's pixels, of all or of a rectangle, and what their z_depth is along. */
  cameraRays(camera, { x, y, width, height } = { x: 0, y: 0, width: camera.width, height: camera.height }) {
    const pixels = width * height, pinhole = LENS.some(name => camera[name]) ? null : pinholeOf(camera);
    const origins = new Float32Array(3 * pixels), dirs = new Float32Array(3 * pixels);
    for (let i = 0; i < pixels; i++) {
      const [u, v] = [x + i % width + 0.5, y + Math.floor(i / width) + 0.5];
      const ray = pinhole ? pinhole(u, v) : this.cameraRay(camera, u, v);
      origins.set(ray.origin, 3 * i);
      dirs.set(ray.dir, 3 * i);
    }
    return { origins, dirs, axis: this.cameraRay(camera, camera.cx, camera.cy).dir };
  }

  /** Rays of a rectangle for `rays`, which begin and end at the sides of a box. */
  croppedRays({ camera, rect, crop }) {
    const rays = this.cameraRays(camera, rect), pixels = rect.width * rect.height;
    const t_min = new Float32Array(pixels), t_max = new Float32Array(pixels);
    for (let i = 0; i < pixels; i++) {
      let [from, to] = [0, Infinity];
      for (let axis = 0; axis < 3; axis++) {
        const [origin, dir] = [rays.origins[3 * i + axis], rays.dirs[3 * i + axis]];
        const [a, b] = [(crop.min[axis] - origin) / dir, (crop.max[axis] - origin) / dir];
        // The sum is NaN for a ray that lies in a side of the box.
        if (!Number.isNaN(a + b)) [from, to] = [Math.max(from, Math.min(a, b)), Math.min(to, Math.max(a, b))];
      }
      if (from < to) [t_min[i], t_max[i]] = [from, to];
    }
    return { ...rays, t_min, t_max };
  }

  /** Milliseconds at each point of the front, on this thread. */
  pace({ camera, planes, limit }) {
    const { library } = this;
    this.clock ??= library.clock(() => BigInt(Math.round(1000 * performance.now())));
    const request = library.structure('nerf_pace_request', {
      scene: this.handle, camera: library.structure('nerf_camera', camera), outputs: outputsOf(planes),
      limit_milliseconds: limit, clock: this.clock,
    });
    library.call('nerf_pace_workspace_size', request, library.out, library.out + 4);
    const size = library.answer()[0], pace = library.structure('nerf_pace');
    library.call('nerf_pace_measure', request, library.room('workspace', size), size, pace);
    return library.read('nerf_pace', pace).milliseconds;
  }

  /** The settings that lose least in that time at a pace, and what they lose. */
  within({ milliseconds, pace }) {
    const { library } = this;
    const options = library.structure('nerf_render_options', {});
    const choice = library.structure('nerf_choice');
    library.call('nerf_quality_within_time', this.handle, milliseconds,
      library.structure('nerf_pace', { milliseconds: pace }), options, choice);
    return { options: library.read('nerf_render_options', options), choice: library.read('nerf_choice', choice) };
  }

  /** A frame in words. */
  explain({ options = null, planes, counters }) {
    const { library } = this;
    const [text, capacity] = [library.room('text', 8192), 8192];
    library.call('nerf_explain', this.worker(options, planes),
      library.structure('nerf_counters', { ...counters, struct_size: STRUCTURES.nerf_counters.size }), text, capacity, 0);
    return library.text(text, new Uint8Array(library.memory, text, capacity).indexOf(0));
  }
}

export { Library, Scene, STRUCTURES };
