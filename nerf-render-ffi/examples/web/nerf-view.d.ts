/** What is shown of a scene; numbers by a colour map, from the nearest to the farthest. */
export type Output = 'colour' | 'depth' | 'normals' | 'opacity' | 'distance' | 'median';

/** Of a picture that was put up: `full` is in full quality, at rest; others are quick ones, while the view changes. */
export interface DrawDetail {
  full: boolean;
  /** Pixels that were drawn: of a quick picture fewer than are shown. */
  width: number;
  height: number;
  /** From the first ray to the last pixel. */
  milliseconds: number;
}

export interface NerfViewEventMap extends HTMLElementEventMap {
  /** The first picture of a scene is shown. */
  load: Event;
  /** There is none: `message` is the sentence that the element shows. */
  error: ErrorEvent;
  draw: CustomEvent<DrawDetail>;
}

/** `<nerf-view src="scene.nerf" alt="what it shows" controls></nerf-view>` */
export class NerfView extends HTMLElement {
  /** The address of a scene, as the attribute has it. */
  src: string;
  /** What the scene shows, for who does not see it. */
  alt: string;
  /** Whether pointer, wheel, keys and buttons move the view. */
  controls: boolean;
  output: Output;

  /**
   * Opens a scene that the page has, in place of `src`, or a newer checkpoint of the one that is shown, whose view stays where
   * it was moved. Rejects with a sentence where it cannot be opened; what was shown before stays.
   */
  open(scene: Blob | BufferSource): Promise<void>;
  /** Turns the view as a drag by so many CSS pixels does. */
  turn(right: number, down: number): void;
  /** Multiplies the distance from what is looked at. */
  dolly(factor: number): void;
  /** Goes back to the first view. */
  reset(): void;
  /** Takes over the size of the element, as it does by itself before the next frame. */
  resize(): void;

  addEventListener<K extends keyof NerfViewEventMap>(type: K, listener: (this: NerfView, event: NerfViewEventMap[K]) => void,
    options?: boolean | AddEventListenerOptions): void;
  addEventListener(type: string, listener: EventListenerOrEventListenerObject, options?: boolean | AddEventListenerOptions): void;
}

declare global {
  interface HTMLElementTagNameMap {
    'nerf-view': NerfView;
  }
}
