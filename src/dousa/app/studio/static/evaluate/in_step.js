// Keeps a film or a piece of music in step with the player: the player leads, and its moments are seconds of the
// performance. start() says when the medium begins.

const DRIFT = 0.12; // s that it may be off while it plays
const STILL = 0.02;

export class InStep {
  constructor(media, player, start) {
    Object.assign(this, { media, player, start, held: false });
    this.end = player.onTime(() => this.follow());
    media.addEventListener("loadedmetadata", () => this.follow());
    media.addEventListener("seeked", () => !player.playing && this.follow());
    this.follow();
  }

  /** Not held: it goes where the player is. */
  follow() {
    const { media, player } = this;
    if (this.held || !media.readyState) return;
    const want = player.time - this.start();
    const inside = want >= 0 && want < (media.duration || 0);
    if (!player.playing || !inside) {
      if (!media.paused) media.pause();
      const to = Math.min(Math.max(want, 0), media.duration || 0);
      if (!media.seeking && Math.abs(media.currentTime - to) > STILL) media.currentTime = to;
      return;
    }
    if (media.playbackRate !== player.speed) media.playbackRate = player.speed;
    if (!media.seeking && Math.abs(media.currentTime - want) > Math.max(DRIFT, DRIFT * player.speed)) media.currentTime = want;
    if (media.paused && !this.asked) {
      this.asked = true;
      media.play().catch(() => {}).finally(() => { this.asked = false; });
    }
  }

  hold(held) {
    this.held = held;
    if (held) this.media.pause();
    else this.follow();
  }

  destroy() {
    this.end();
    this.media.pause();
    this.media.removeAttribute("src");
    this.media.load();
  }
}
