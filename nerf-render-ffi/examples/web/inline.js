/** What stands in the page under an id, as the address of a file. */
const dataOf = (id, type) => `data:${type};base64,${element(id).textContent.trim()}`;
const LIBRARY = dataOf('module', 'application/wasm');
const script = URL.createObjectURL(new Blob([element('library').textContent], { type: 'text/javascript' }));
// No module: a page on disk cannot start one.
const startWorker = () => new Worker(script);
