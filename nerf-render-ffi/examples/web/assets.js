/** Where the module and the workers' script are; a page in one file has its own, by inline.js in place of this. */
const LIBRARY = new URL('nerf_render.wasm', import.meta.url);
const script = new URL('worker.js', import.meta.url);
/** A worker's script must be of the page's origin: one from elsewhere is imported by one that is. */
const address = script.origin === location.origin ? script
  : URL.createObjectURL(new Blob([`import ${JSON.stringify(script)};`], { type: 'text/javascript' }));
const startWorker = () => new Worker(address, { type: 'module' });

export { LIBRARY, startWorker };
