export type Kernel = 'auto' | 'portable' | 'simd128';
/** `rgba`: four bytes of a pixel as a canvas takes them; of others floats, three of a pixel's `rgb` and `normals`. */
export type Plane = 'rgba' | 'rgb' | 'opacity' | 'ray_distance' | 'z_depth' | 'median_distance' | 'normals';
export type Planes = { rgba?: Uint8ClampedArray } & { [name in Exclude<Plane, 'rgba'>]?: Float32Array };

/** `nerf_camera`: pixels, and the rows of a camera-to-world matrix, 12 numbers; looks along its -z. */
export interface Camera {
  width: number; height: number; fx: number; fy: number; cx: number; cy: number; c2w: number[];
  k1?: number; k2?: number; k3?: number; k4?: number; k5?: number; k6?: number; p1?: number; p2?: number; lens_model?: number;
}

export interface Rendered {
  planes: Planes;
  /** Fields of `nerf_counters`. */
  counters: { [name: string]: bigint };
}

/** A scene in a WebAssembly memory of its own, on the thread that calls it. Methods throw what the library says. */
export class Scene {
  constructor(module: WebAssembly.Module, blob: Uint8Array, kernel: Kernel);
  /** Fields of `nerf_scene_info`. */
  describe(): { [name: string]: any };
  /** `options`: fields of `nerf_render_options`, null for the defaults; `limits`: where rays of each pixel end. */
  render(request: {
    camera: Camera; rect: { x: number; y: number; width: number; height: number }; planes: Plane[]; options?: object | null;
    limits?: { limit_ray_distance?: Float32Array; limit_z_depth?: Float32Array } | null;
  }): Rendered;
  /** What rays of the page's own see: `origins`, `dirs` three floats of each, `dirs` of unit length; `axis` for `z_depth`. */
  rays(request: {
    origins: Float32Array; dirs: Float32Array; t_min?: Float32Array | null; t_max?: Float32Array | null;
    axis?: Float32Array | null; planes: Plane[]; options?: object | null;
  }): Rendered;
  /** The rays of a camera's pixels, for `rays`. */
  cameraRays(camera: Camera): { origins: Float32Array; dirs: Float32Array; axis: Float32Array };
}
