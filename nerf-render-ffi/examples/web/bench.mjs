// Compares the kernels of a module outside a browser: the fastest of several frames, kernels in turn, by the
// processor's time, since other programs run too.
//   node bench.mjs target/web/wasm32-unknown-unknown/web/nerf_render.wasm scene.nerf [pixels a side] [frames]
import { readFileSync } from 'node:fs';
import { Scene } from './abi.js';
import { Orbit } from './view.js';

const [file, blob, side = '100', frames = '10'] = process.argv.slice(2);
const module = new WebAssembly.Module(readFileSync(file));
const kernels = ['portable', 'simd128'].map(kernel => ({ kernel, fastest: Infinity, scene: new Scene(module, readFileSync(blob), kernel) }));

const info = kernels[0].scene.describe();
const centre = info.box_min.map((low, i) => 0.5 * (low + info.box_max[i]));
const view = new Orbit(centre, 0.5 * (info.near_distance + info.far_distance), [0, 0, 1], [[1, 0, 0], [0, 1, 0]]);
const camera = view.camera(Number(side), Number(side), 40 * Math.PI / 180);
const request = { camera, rect: { x: 0, y: 0, width: camera.width, height: camera.height }, planes: ['rgb', 'z_depth'] };
let bits = null;
for (let i = 0; i <= Number(frames); i++) {
  for (const one of kernels) {
    const began = process.cpuUsage();
    const { planes, counters } = one.scene.render(request);
    // The first frame is not measured: the engine compiles the module then.
    const { user, system } = process.cpuUsage(began);
    if (i > 0) one.fastest = Math.min(one.fastest, (user + system) / 1000);
    one.flop = 2 * Number(counters.macs);
    const found = Buffer.from(planes.rgb.buffer).toString('hex');
    if (found !== (bits ??= found)) throw new Error(`${one.kernel}: other bits`);
  }
}
for (const { kernel, fastest, flop } of kernels) {
  console.log(`${kernel}: ${fastest.toFixed(1)} ms, ${(flop / fastest / 1e6).toFixed(1)} GFLOP/s`);
}
console.log(`simd128 is ${(kernels[0].fastest / kernels[1].fastest).toFixed(2)} times portable, bit for bit the same picture`);
