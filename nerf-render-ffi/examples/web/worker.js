import { Scene, STRUCTURES } from './abi.js';
import { colours, MODES, samplesOf } from './output.js';

/** One scene on a thread of its own; each message is `{ id, call, with }`, each answer `{ id, found }` or `{ id, error }`. */
let scene = null;
const calls = {
  async open({ module, blob, kernel }) {
    const opened = new Scene(module, new Uint8Array(await blob.arrayBuffer()), kernel), info = opened.describe();
    if (info.kind !== 1) throw new Error('expected a scene, found a picture');
    scene = opened;
    return info;
  },
  render(request) {
    const rays = request.crop && scene.croppedRays(request);
    return rays ? scene.rays({ ...request, ...rays }) : scene.render(request);
  },
  /** A tile as a canvas takes it. */
  paint({ look, ...request }) {
    const began = performance.now(), { unit, planes: names } = MODES[look.mode];
    const { planes, counters } = calls.render({ ...request, crop: look.crop, planes: names });
    const rgba = colours(look, planes, request.rect.width * request.rect.height);
    const samples = unit ? samplesOf(look.mode, planes) : [];
    return { planes: { rgba }, counters, samples, milliseconds: performance.now() - began };
  },
  rays: request => scene.rays(request),
  cameraRays: camera => scene.cameraRays(camera),
  pace: request => scene.pace(request),
  within: request => scene.within(request),
  explain: request => scene.explain(request),
  layouts: () => STRUCTURES,
};

/** One call at a time, in their order. */
let last = Promise.resolve();
onmessage = ({ data }) => {
  last = last.then(async () => {
    try {
      const found = await calls[data.call](data.with);
      postMessage({ id: data.id, found }, Object.values(found.planes ?? {}).map(plane => plane.buffer));
    } catch (error) {
      postMessage({ id: data.id, error: String(error.message || error) });
    }
  });
};
