// The 3D figure, which grows while its frames are found.

import { get } from "../core/api.js";

const REST = 4; // a figure is asked for again after so many times what the last answer took
const [LEAST, MOST] = [500, 4000]; // ms between two answers

export class Figure {
  /** onTime(seconds) when the player stands somewhere else; onShown() when it has grown. */
  constructor(place, onTime, onShown) {
    Object.assign(this, { place, onTime, onShown, player: null, ready: 0, quiet: false });
  }

  get playing() {
    return Boolean(this.player?.playing);
  }

  /** Ask for the figure as far as it is, as soon as it is time. */
  async refresh(path, params, live) {
    const now = performance.now();
    if (now < this.ready) {
      this.again(path, params, live);
      return;
    }
    this.ready = Infinity; // until the answer is there
    clearTimeout(this.timer);
    const data = await get(path, params).catch(() => null); // the studio is away: what is shown stays
    if (this.dead) return;
    if (data) this.show(data, live);
    this.ready = performance.now() + Math.min(Math.max(LEAST, REST * (performance.now() - now)), MOST);
    if (data) this.onShown();
    if (this.asked) this.again(...this.asked);
  }

  // What came too soon is asked for later, so that the last frames are never left out.
  again(...asked) {
    clearTimeout(this.timer);
    this.asked = asked;
    if (this.ready === Infinity) return; // the answer under way takes this up
    const go = () => {
      this.asked = null;
      this.refresh(...asked);
    };
    this.timer = setTimeout(go, Math.max(this.ready - performance.now(), 0) + 10);
  }

  show(data, live) {
    if (this.player) {
      this.without(() => this.player.replace(data, { live: Boolean(live) }));
      return;
    }
    this.player = window.dousa.createPlayer(this.place, data);
    this.player.onTime((seconds) => this.quiet || this.onTime(seconds));
  }

  // What we do ourselves is not told back to us.
  without(action) {
    this.quiet = true;
    action();
    this.quiet = false;
  }

  seek(seconds) {
    if (this.player) this.without(() => this.player.seek(Math.min(seconds, this.player.duration)));
  }

  playOnce() {
    if (!this.player || matchMedia("(prefers-reduced-motion: reduce)").matches) return;
    this.player.seek(0);
    this.player.play();
  }

  destroy() {
    this.dead = true;
    clearTimeout(this.timer);
    this.player?.destroy();
    this.place.replaceChildren();
  }
}
