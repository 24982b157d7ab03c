// What a page sees: window.dousa, and handles that hide everything else.

function createPlayer(element, data, options = {}) {
  const inner = new Player(element, data, options);
  return Object.freeze({
    seek: (seconds) => inner.seek(seconds),
    play: () => inner.play(),
    pause: () => inner.pause(),
    loop: (start, end) => inner.loop(start, end),
    setSpeed: (speed) => inner.setSpeed(speed),
    setView: (view) => inner.setView(view),
    replace: (data, how = {}) => inner.replace(data, how),
    onTime(callback) {
      inner.listeners.add(callback);
      return () => inner.listeners.delete(callback);
    },
    reveal: () => inner.reveal(),
    destroy: () => inner.destroy(),
    element: inner.root,
    get time() {
      return inner.time;
    },
    get duration() {
      return inner.duration;
    },
    get playing() {
      return inner.playing;
    },
    get speed() {
      return inner.speed;
    },
    get view() {
      return { ...inner.view };
    },
    get looped() {
      return inner.looped ? [...inner.looped] : null;
    },
  });
}

function createClock(options = {}) {
  const inner = new Clock(options);
  return Object.freeze({
    play: () => inner.play(),
    pause: () => inner.pause(),
    seek: (share) => inner.seek(share),
    follow: (player) => inner.follow(player),
    onChange: (callback) => inner.onChange(callback),
    destroy: () => inner.destroy(),
    get share() {
      return inner.share;
    },
    get playing() {
      return inner.playing;
    },
    get duration() {
      return inner.duration;
    },
  });
}

function createMiniature(canvas, bytes, options = {}) {
  const inner = new Miniature(canvas, bytes, options);
  const want = (running) => {
    if (inner.clock) running ? inner.clock.play() : inner.clock.pause();
    else inner.wanted = running;
    inner.settle();
  };
  return Object.freeze({
    play: () => want(true),
    pause: () => want(false),
    seek(share) {
      if (!Number.isFinite(share)) return;
      if (inner.clock) inner.clock.seek(share);
      else inner.set(share);
    },
    scrub(share) {
      if (share === null || Number.isFinite(share)) inner.scrub(share);
    },
    replace(bytes) {
      inner.load(bytes);
      inner.settle();
      inner.touch();
    },
    destroy: () => inner.destroy(),
    element: canvas,
    get calm() {
      return lessMotion.matches;
    },
    get share() {
      return inner.share;
    },
    get playing() {
      return inner.playing;
    },
    get visible() {
      return inner.visible;
    },
    get duration() {
      return inner.duration;
    },
  });
}

const miniatures = Object.freeze({
  get alive() {
    return gallery.alive;
  },
  get count() {
    return gallery.all.size;
  },
  get drawn() {
    return gallery.drawn;
  },
  get patience() {
    return gallery.patience;
  },
  set patience(milliseconds) {
    gallery.patience = milliseconds;
  },
});

window.dousa = Object.assign(window.dousa ?? {}, { createPlayer, createMiniature, createClock, miniatures });
