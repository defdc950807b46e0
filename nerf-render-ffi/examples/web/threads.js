
/** A worker whose messages are promises. */
class Thread {
  constructor(url) {
    this.waiting = new Map();
    this.last = 0;
    this.worker = new Worker(url);
    this.worker.onerror = failed;
    this.worker.onmessage = ({ data }) => {
      const { resolve, reject } = this.waiting.get(data.id);
      this.waiting.delete(data.id);
      if (data.error === undefined) resolve(data.found); else reject(new Error(data.error));
    };
  }

  ask(call, more) {
    const id = ++this.last;
    this.worker.postMessage({ id, call, with: more });
    return new Promise((resolve, reject) => this.waiting.set(id, { resolve, reject }));
  }
}

/** Ends with whatever is under way. */
let queue = Promise.resolve();

/** Does something once all that was queued before has ended: what opens scenes changes the threads the others ask. */
function queued(action) {
  const done = queue.then(action);
  queue = done.catch(() => {});
  return done;
}

/** Opens the scene on new threads with a kernel. */
const open = kernel => queued(async () => {
  module ??= new WebAssembly.Module(bytes('module'));
  blob ??= await firstBlob();
  body.dataset.imports = WebAssembly.Module.imports(module).map(it => it.name).join(' ');
  body.dataset.exports = WebAssembly.Module.exports(module).map(it => it.name).join(' ');
  const url = URL.createObjectURL(new Blob([element('library').textContent], { type: 'text/javascript' }));
  const count = Math.max(1, Math.min(8, navigator.hardwareConcurrency || 1));
  const made = Array.from({ length: count }, () => new Thread(url));
  const infos = await Promise.all(made.map(thread => thread.ask('open', { module, blob, kernel })));
  // A frame that is under way ends on the old ones.
  retired.push(...threads);
  [threads, info, pace, pixelMs] = [made, infos[0], null, null];
  body.dataset.kernel = info.kernel;
  if (info.kind !== 1) throw new Error('this page draws scenes, and the file holds a picture');
});

/** Opens a newer checkpoint of the scene on the threads there are. */
const reopen = newer => queued(async () => {
  [info] = await Promise.all(threads.map(thread => thread.ask('open', { module, blob: newer, kernel: info.kernel })));
  [blob, pace] = [newer, null];
  if (!touched && !info.up.some(Boolean)) view.centre = await middle();
  change();
});

