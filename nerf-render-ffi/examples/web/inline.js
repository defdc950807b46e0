/** What stands in the page under an id, as the address of a file. */
const dataOf = (id, type) => `data:${type};base64,${element(id).textContent.trim()}`;
const LIBRARY = dataOf('module', 'application/wasm');
const script = URL.createObjectURL(new Blob([element('library').textContent], { type: 'text/javascript' }));
// A classic worker: a page on disk cannot start a module as a worker.
const startWorker = () => new Worker(script);
