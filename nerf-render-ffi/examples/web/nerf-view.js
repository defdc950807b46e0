import { Picture } from './draw.js';
import { MODES } from './output.js';
import { fetched } from './threads.js';

/** The longer side of a picture: where the element does not say, and at most. */
const PIXELS = 960, MAX_PIXELS = 4096;
const MAX_THREADS = 8;

const STYLE = `
  :host { display: inline-block; position: relative; width: 400px; aspect-ratio: 1; background: #16181d; }
  canvas { position: absolute; inset: 0; width: 100%; height: 100%; }
  :host([controls]) canvas { cursor: grab; touch-action: none; }
  :host([controls]) canvas.turning { cursor: grabbing; }
  canvas:focus-visible { outline: 2px solid #6ca8ff; outline-offset: 2px; }
  div { position: absolute; left: 8px; bottom: 8px; display: flex; gap: 4px; }
  button { width: 28px; height: 28px; padding: 0; font: 16px/1 system-ui, sans-serif; color: #fff; background: #212126c0;
    border: 1px solid #ffffff80; border-radius: 4px; cursor: pointer; }
  p { position: absolute; inset: 40% 1em auto; margin: 0; text-align: center; font: 14px/1.4 system-ui, sans-serif; color: #fff;
    overflow-wrap: anywhere; }
  #where { clip-path: inset(50%); }
  :host([hidden]), [hidden] { display: none; }`;
/** What moves the view: its name, what its button shows, its keys, and what it does. */
const MOVES = [
  ['turn left', '←', ['ArrowLeft'], view => view.turn(-12, 0)],
  ['turn right', '→', ['ArrowRight'], view => view.turn(12, 0)],
  ['turn up', '↑', ['ArrowUp'], view => view.turn(0, -12)],
  ['turn down', '↓', ['ArrowDown'], view => view.turn(0, 12)],
  ['come nearer', '+', ['+', '='], view => view.dolly(0.9)],
  ['go away', '−', ['-'], view => view.dolly(1 / 0.9)],
  ['reset the view', '⟲', ['r', 'R'], view => view.reset()],
];

function made(name, attributes, ...inner) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...inner);
  return element;
}

/** `<nerf-view src="scene.nerf" alt="what it shows" controls></nerf-view>`: nerf-view.md. */
class NerfView extends HTMLElement {
  static observedAttributes = ['src', 'alt', 'controls', 'output', 'pixels', 'threads', 'up'];
  /** What draws, while there is something to: no part of the package's interface. */
  picture = null;
  #canvas = made('canvas', { width: 1, height: 1 });
  #buttons = made('div', { role: 'group', 'aria-label': 'view' }, ...MOVES.map(([name, shown, , action]) => {
    const button = made('button', { type: 'button', title: name, 'aria-label': name }, shown);
    button.addEventListener('click', () => this.picture?.move(action));
    return button;
  }));
  #says = made('p', { role: 'status' });
  #where = made('p', { role: 'status', id: 'where' });
  #sizes = new ResizeObserver(() => this.resize());
  #loading = null;
  #shown = false;
  /** Pointers that are down, and where. */
  #held = new Map();

  constructor() {
    super();
    const root = this.attachShadow({ mode: 'open', delegatesFocus: true }), style = new CSSStyleSheet();
    style.replaceSync(STYLE);
    root.adoptedStyleSheets = [style];
    root.append(this.#canvas, this.#buttons, this.#says, this.#where);
    for (const kind of ['down', 'move', 'up', 'cancel']) {
      this.#canvas.addEventListener(`pointer${kind}`, event => this.#point(event));
    }
    this.#canvas.addEventListener('wheel', event => this.#wheel(event), { passive: false });
    this.#canvas.addEventListener('keydown', event => this.#press(event));
  }

  get src() { return this.getAttribute('src') ?? ''; }
  set src(value) { this.setAttribute('src', value); }
  get alt() { return this.getAttribute('alt') ?? ''; }
  set alt(value) { this.setAttribute('alt', value); }
  get controls() { return this.hasAttribute('controls'); }
  set controls(value) { this.toggleAttribute('controls', value); }
  get output() { return MODES[this.getAttribute('output')] ? this.getAttribute('output') : 'colour'; }
  set output(value) { this.setAttribute('output', value); }

  connectedCallback() {
    this.#sizes.observe(this);
    this.#label();
    this.#load();
  }

  disconnectedCallback() {
    this.#sizes.disconnect();
    this.#end();
  }

  attributeChangedCallback(name, before, now) {
    if (before === now || !this.isConnected) return;
    if (name === 'alt' || name === 'controls') this.#label();
    else if (name === 'output') this.picture?.show({ mode: this.output, range: null });
    else if (name === 'pixels') this.resize();
    else if (this.src || name === 'src') this.#load();
  }

  /** Opens a scene that the page has, or a newer checkpoint of the one that is shown, whose view stays where it was moved. */
  async open(scene) {
    if (!this.isConnected) throw new Error('expected an element in a document, found one outside');
    this.#loading?.abort();
    const picture = this.picture ?? this.#begin();
    try {
      await picture.open(scene instanceof Blob ? scene : new Blob([scene]));
      this.#label();
    } catch (error) {
      if (picture === this.picture && !picture.info) this.#fail(error);
      throw error;
    }
  }

  turn(right, down) { this.picture?.move(view => view.turn(right, down)); }
  dolly(factor) { this.picture?.move(view => view.dolly(factor)); }
  reset() { this.picture?.move(view => view.reset()); }

  /** Takes over the size of the element, as it does by itself before the next frame. */
  resize() {
    const shown = [this.clientWidth, this.clientHeight], longer = Math.max(...shown);
    if (!this.picture || !longer) return;
    const longest = Math.min(MAX_PIXELS, Number(this.getAttribute('pixels')) || Math.min(PIXELS, longer * devicePixelRatio));
    this.picture.resize(...shown.map(side => Math.max(1, Math.round(side * longest / longer))));
  }

  #begin() {
    const threads = Math.floor(this.getAttribute('threads')) || navigator.hardwareConcurrency || 1;
    const picture = new Picture(this.#canvas, {
      threads: Math.max(1, Math.min(MAX_THREADS, threads)), up: this.getAttribute('up'),
      tell: (name, detail) => { if (picture === this.picture) this.#tell(name, detail); },
    });
    picture.look.mode = this.output;
    [this.picture, this.#shown] = [picture, false];
    this.#say('loading…');
    this.resize();
    return picture;
  }

  #end() {
    this.#loading?.abort();
    this.picture?.stop();
    this.picture = null;
    this.#held.clear();
    this.#canvas.width = 1;
    this.#say('');
  }

  async #load() {
    this.#end();
    if (!this.src) return;
    const { signal } = this.#loading = new AbortController();
    this.#begin();
    try {
      const scene = await (await fetched(this.src, { signal })).blob();
      if (!signal.aborted) this.open(scene).catch(() => {}); // which is said by then
    } catch (error) {
      if (!signal.aborted) this.#fail(error);
    }
  }

  #fail(error) {
    this.#end();
    const message = this.src ? `${this.src.slice(-80)}: ${error.message}` : error.message;
    this.#say(message);
    this.dispatchEvent(new ErrorEvent('error', { message, error }));
  }

  #tell(name, detail) {
    if (name === 'error') {
      this.#fail(detail);
      return;
    }
    if (detail.full && this.picture.touched) this.#where.textContent = this.picture.view.inWords();
    if (!this.#shown) {
      this.#shown = true;
      this.#say('');
      this.dispatchEvent(new Event('load'));
    }
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }

  #say(text) {
    this.#says.textContent = text;
    this.#says.hidden = !text;
  }

  /** What it is for who does not see it. */
  #label() {
    const { controls } = this, canvas = this.#canvas;
    const alt = this.getAttribute('alt') ?? (this.picture?.info?.data || 'a scene');
    canvas.setAttribute('role', controls ? 'application' : alt ? 'img' : 'presentation');
    const keys = controls ? 'arrow keys turn it, plus and minus come nearer and go away, R resets' : '';
    canvas.setAttribute('aria-label', [alt, keys].filter(Boolean).join('; '));
    if (controls) canvas.tabIndex = 0; else canvas.removeAttribute('tabindex');
    this.#buttons.hidden = !controls;
  }

  #press(event) {
    const move = MOVES.find(([, , keys]) => keys.includes(event.key));
    if (!this.controls || !move || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    this.picture?.move(move[3]);
  }

  #wheel(event) {
    if (!this.controls) return;
    event.preventDefault();
    const pixels = event.deltaY * (event.deltaMode === 1 ? 30 : 1);
    this.dolly(Math.exp(0.0015 * Math.max(-300, Math.min(300, pixels))));
  }

  #point(event) {
    const { type, pointerId, clientX, clientY } = event, held = this.#held, now = [clientX, clientY];
    const last = held.get(pointerId);
    if (type === 'pointerdown' && this.controls) {
      held.set(pointerId, now);
      // A synthetic pointer cannot be captured.
      if (event.isTrusted) this.#canvas.setPointerCapture(pointerId);
    } else if (type !== 'pointermove') {
      held.delete(pointerId);
    } else if (last) {
      held.set(pointerId, now);
      const [other] = [...held].filter(([id]) => id !== pointerId).map(([, place]) => place);
      const apart = place => Math.max(10, Math.hypot(place[0] - other[0], place[1] - other[1]));
      if (other) this.dolly(apart(last) / apart(now));
      else this.turn(now[0] - last[0], now[1] - last[1]);
    }
    this.#canvas.classList.toggle('turning', held.size > 0);
  }
}

customElements.define('nerf-view', NerfView);

export { NerfView };
