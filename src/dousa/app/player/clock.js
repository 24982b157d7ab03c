// dousa.createClock({duration}) -> clock
//
// One time for several miniatures: a share, 0 to 1, of whatever each of them shows.
//   clock.play() .pause() .seek(share) .follow(player) -> function that ends it .destroy()
//   clock.onChange(callback) -> function that stops the calls; callback(share) after every change
//   to read: clock.share .playing .duration (s of one round; a player's own while one is followed)
// While it follows a player, the player is the master: play, pause and seek are handed on to it.

class Clock {
  constructor(options = {}) {
    this.period = options.duration > 0 && Number.isFinite(options.duration) ? options.duration : 4;
    Object.assign(this, { share: 0, running: false, listeners: new Set(), waiting: 0, last: null, player: null });
  }

  get playing() {
    return this.player ? this.player.playing : this.running;
  }

  get duration() {
    return this.player ? this.player.duration : this.period;
  }

  play() {
    if (this.player) this.player.play();
    else if (!this.running) {
      Object.assign(this, { running: true, last: null });
      this.request();
    }
  }

  pause() {
    if (this.player) this.player.pause();
    else this.stop();
  }

  stop() {
    this.running = false;
    cancelAnimationFrame(this.waiting);
    this.waiting = 0;
  }

  seek(share) {
    if (!Number.isFinite(share)) return;
    const inside = Math.min(Math.max(share, 0), 1);
    if (this.player) this.player.seek(inside * this.player.duration);
    else this.set(inside);
  }

  set(share) {
    this.share = share;
    for (const callback of [...this.listeners]) callback(share);
  }

  request() {
    this.waiting = requestAnimationFrame((now) => {
      if (this.last !== null) {
        const passed = Math.min((now - this.last) / 1000, LONGEST_STEP) / this.period;
        this.set((this.share + passed) % 1);
      }
      this.last = now;
      if (this.running) this.request();
    });
  }

  follow(player) {
    this.unfollow?.();
    this.stop();
    this.player = player;
    const take = () => this.set(player.time / player.duration);
    const stop = player.onTime(take);
    take();
    const mine = (this.unfollow = () => {
      stop();
      Object.assign(this, { player: null, unfollow: null });
    });
    return () => {
      if (this.unfollow === mine) mine();
    };
  }

  onChange(callback) {
    this.listeners.add(callback);
    return () => this.listeners.delete(callback);
  }

  destroy() {
    this.unfollow?.();
    this.stop();
    this.listeners.clear();
  }
}
