// What a page sees: window.dousa, and handles that hide everything else.

// A frozen handle: `methods`, and the `calls` and `values` of `inner` by their names.
function makeHandle(inner, { calls, values, methods }) {
  for (const name of calls) methods[name] = (...given) => inner[name](...given);
  for (const name of values) Object.defineProperty(methods, name, { get: () => inner[name], enumerable: true });
  return Object.freeze(methods);
}

function createPlayer(element, data, options = {}) {
  const inner = new Player(element, data, options);
  const methods = {
    onTime(callback) {
      inner.listeners.add(callback);
      return () => inner.listeners.delete(callback);
    },
    element: inner.root,
    get view() {
      return { ...inner.view };
    },
    get looped() {
      return inner.looped ? [...inner.looped] : null;
    },
  };
  const calls = ["seek", "play", "pause", "toggle", "loop", "setSpeed", "setView", "replace", "reveal", "destroy"];
  return makeHandle(inner, { calls, values: ["time", "duration", "playing", "speed"], methods });
}

function createClock(options = {}) {
  const calls = ["play", "pause", "seek", "follow", "onChange", "destroy"];
  return makeHandle(new Clock(options), { calls, values: ["share", "playing", "duration"], methods: {} });
}

function createMiniature(canvas, bytes, options = {}) {
  const inner = new Miniature(canvas, bytes, options);
  const want = (running) => {
    if (inner.clock) running ? inner.clock.play() : inner.clock.pause();
    else inner.wanted = running;
    inner.settle();
  };
  const methods = {
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
    element: canvas,
    get calm() {
      return lessMotion.matches;
    },
  };
  return makeHandle(inner, { calls: ["destroy"], values: ["share", "playing", "visible", "duration"], methods });
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
