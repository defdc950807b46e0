import { LIBRARY, startWorker } from './assets.js';

/** A module of one instruction of SIMD. */
const SIMD = Uint8Array.of(0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 10, 1, 8, 0, 65, 0, 253, 15,
  253, 98, 11);

/** A file of the page's, or an error that says why there is none. */
async function fetched(address, options) {
  let answer;
  try {
    answer = await fetch(address, options);
  } catch (error) {
    throw new Error(`cannot be loaded: ${error.message}`, { cause: error });
  }
  if (!answer.ok) throw new Error(`cannot be loaded: the server answers ${answer.status} ${answer.statusText}`.trim());
  return answer;
}

async function compile() {
  if (typeof WebAssembly !== 'object' || !WebAssembly.validate(SIMD)) {
    throw new Error('this browser has no WebAssembly SIMD, which drawing needs; browsers of 2023 and later have it');
  }
  try {
    // compileStreaming would need a server that sends the MIME type of WebAssembly.
    return await WebAssembly.compile(await (await fetched(LIBRARY)).arrayBuffer());
  } catch (error) {
    compiled = null;
    throw new Error(`nerf_render.wasm ${error.message}`, { cause: error });
  }
}

let compiled = null;
/** The library's module, compiled once for all scenes of the page. */
const library = () => compiled ??= compile();

const CLOSED = 'closed before it was drawn';

/** A worker whose messages are promises. */
class Thread {
  constructor() {
    this.waiting = new Map();
    this.last = 0;
    this.worker = startWorker();
    this.worker.onerror = ({ message }) => this.end(message || 'worker.js cannot be loaded');
    this.worker.onmessage = ({ data }) => {
      const { resolve, reject } = this.waiting.get(data.id);
      this.waiting.delete(data.id);
      if (data.error === undefined) resolve(data.found); else reject(new Error(data.error));
    };
  }

  /** Ends the worker, and what is asked of it with an error. */
  end(why = CLOSED) {
    this.worker.terminate();
    for (const { reject } of this.waiting.values()) reject(new Error(why));
    this.waiting.clear();
  }

  ask(call, more) {
    const id = ++this.last;
    this.worker.postMessage({ id, call, with: more });
    return new Promise((resolve, reject) => this.waiting.set(id, { resolve, reject }));
  }
}

export { CLOSED, fetched, library, Thread };
