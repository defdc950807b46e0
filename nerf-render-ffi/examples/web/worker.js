
/** One scene on a thread of its own; each message is `{ id, call, with }`, each answer `{ id, found }` or `{ id, error }`. */
let scene = null;
const calls = {
  open({ module, blob, kernel }) {
    scene = new Scene(module, blob, kernel);
    return scene.describe();
  },
  render(request) {
    const rays = request.crop && scene.croppedRays(request);
    const began = performance.now();
    const found = rays ? scene.rays({ ...request, ...rays }) : scene.render(request);
    return { ...found, milliseconds: performance.now() - began };
  },
  rays: request => scene.rays(request),
  cameraRays: camera => scene.cameraRays(camera),
  pace: request => scene.pace(request),
  within: request => scene.within(request),
  explain: request => scene.explain(request),
  layouts: () => STRUCTURES,
};

onmessage = ({ data }) => {
  try {
    postMessage({ id: data.id, found: calls[data.call](data.with) });
  } catch (error) {
    postMessage({ id: data.id, error: String(error.message || error) });
  }
};
