// dousa.createMiniature(canvas, bytes, options) -> miniature
//
// A motion as a small moving figure, from the bytes (ArrayBuffer or Uint8Array) of encode_miniature.
//   options: clock (of dousa.createClock: the miniature shows its share and does not run by itself),
//     tone ("performance" or "reference": which colour), longest (s; a longer loop runs faster, default 10),
//     host (element whose hover and focus wake it where motion is reduced; default the link or button around it)
//   miniature.play() .pause() .seek(share 0..1) .replace(bytes) .destroy(); to read: .share .playing .visible .duration
//   .scrub(share) shows a moment as long as somebody points at it, .scrub(null) lets it run on; .calm: less motion is wished for
// It runs by itself while it is visible and not behind a dialog, and comes from its last pose to its first without a jump. Where less motion is wished for, it shows its most telling pose until its
// host is hovered or focused. Its size is that of the element. `dousa.miniatures.alive` says how many run now. Where nobody
// does anything on the page for `dousa.miniatures.patience` ms, all of them stand until somebody does.

const FRAME_MS = 1000 / 31; // thirty pictures a second are enough for small ones
const [HOLD, MEND] = [0.15, 0.4]; // s a loop rests at its end, and takes to come back to its beginning
const DIM = 0.5; // of the figure's strength that is lost on the way back: it is no part of the motion
const MINIATURE_COLOURS = ["--dp-mini", "--dp-mini-far", "--dp-mini-shadow"];

const lessMotion = window.matchMedia("(prefers-reduced-motion: reduce)");

// Nobody looks at what lies behind a dialog, and the work that the dialog waits for has the processor.
const LOOK_AGAIN_MS = 250; // between looks whether it is still there
const findDialog = () => document.querySelector("dialog:modal");
const isBehind = (miniature, over) => Boolean(over) && !over.contains(miniature.canvas);

const SIGNS = ["pointermove", "pointerdown", "keydown", "wheel", "scroll", "touchmove", "focusin", "visibilitychange"]; // that somebody is there

// One loop of frames, one observer of each kind, for all miniatures of the page.
const gallery = {
  all: new Set(),
  byCanvas: new Map(),
  waiting: 0,
  last: -Infinity,
  drawn: 0,
  patience: 120_000, // ms: a page that is left open costs nothing
  sign: 0, // ms, when somebody did something last

  add(miniature) {
    if (!this.seen) this.start();
    this.all.add(miniature);
    this.byCanvas.set(miniature.canvas, miniature);
    this.seen.observe(miniature.canvas);
    this.sizes.observe(miniature.canvas);
  },

  remove(miniature) {
    this.all.delete(miniature);
    this.byCanvas.delete(miniature.canvas);
    this.seen.unobserve(miniature.canvas);
    this.sizes.unobserve(miniature.canvas);
  },

  start() {
    this.seen = new IntersectionObserver((entries) => {
      for (const entry of entries) this.byCanvas.get(entry.target)?.show(entry.isIntersecting);
    });
    this.sizes = new ResizeObserver((entries) => {
      for (const entry of entries) this.byCanvas.get(entry.target)?.resize(entry.contentRect);
    });
    this.sign = performance.now();
    for (const name of SIGNS) document.addEventListener(name, () => this.wake(), { capture: true, passive: true });
    onTheme(() => {
      for (const miniature of this.all) miniature.recolour();
    });
    lessMotion.addEventListener("change", () => {
      for (const miniature of this.all) miniature.settle();
    });
  },

  get rests() {
    return performance.now() - this.sign > this.patience;
  },

  wake() {
    this.sign = performance.now();
    this.request();
  },

  get alive() {
    const over = findDialog();
    let count = 0;
    for (const miniature of this.all) count += miniature.moves && !isBehind(miniature, over);
    return count;
  },

  request() {
    if (!this.waiting) this.waiting = requestAnimationFrame((now) => this.tick(now));
  },

  tick(now) {
    this.waiting = 0;
    const due = now - this.last >= FRAME_MS;
    const passed = Math.min(now - this.last, 1000 * LONGEST_STEP) / 1000;
    if (due) this.last = now;
    const over = findDialog();
    let [moving, resting] = [false, false];
    for (const miniature of this.all) {
      if (miniature.moves && isBehind(miniature, over)) resting = true;
      else if (miniature.moves) {
        moving = true;
        if (due) miniature.advance(passed);
      }
      if (miniature.stale && miniature.visible) {
        miniature.draw();
        this.drawn += 1;
      }
    }
    if (moving) this.request();
    else if (resting && !this.pause) this.pause = setTimeout(() => this.lookAgain(), LOOK_AGAIN_MS);
  },

  lookAgain() {
    this.pause = 0;
    this.request();
  },
};

class Miniature {
  constructor(canvas, bytes, options) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.painter = new LoopPainter(this.context);
    this.longest = options.longest > 0 ? options.longest : 10;
    Object.assign(this, { visible: false, stale: true, colours: null, wanted: null, awake: false, held: false, time: 0, share: 0, mend: 0, fade: 1 });
    this.load(bytes);
    canvas.classList.add("dousa-miniature");
    if (options.tone === "reference") canvas.classList.add("dp-mini-reference");
    // Whoever puts it on a page says in words what it is; without them it is an ornament.
    if (!canvas.hasAttribute("aria-label")) canvas.setAttribute("aria-hidden", "true");
    this.ended = new AbortController();
    this.listen(options.host ?? canvas.closest("a, button, [tabindex]") ?? canvas);
    this.clock = options.clock ?? null;
    this.endClock = this.clock?.onChange((share) => this.set(share));
    this.settle();
    gallery.add(this);
  }

  load(bytes) {
    this.loop = new Loop(bytes);
    // A loop shorter than a blink would flicker, a very long one would seem to stand.
    this.duration = Math.min(Math.max(this.loop.duration, 0.3), this.longest);
    this.stale = true;
  }

  listen(host) {
    const wake = ({ type }) => {
      this.awake = ["pointerenter", "focusin"].includes(type);
      this.settle();
    };
    const { signal } = this.ended;
    for (const name of ["pointerenter", "pointerleave", "focusin", "focusout"]) host.addEventListener(name, wake, { signal });
  }

  // Whether it runs: as was asked for, else unless less motion is wished for and nobody looks.
  get playing() {
    if (this.held) return false;
    if (this.clock) return this.clock.playing;
    return this.wanted ?? (!lessMotion.matches || this.awake);
  }

  get moves() {
    if (gallery.rests && !this.clock && !this.awake) return false;
    return this.visible && this.playing && this.loop.duration > 0;
  }

  // After anything that may start or stop it.
  settle() {
    if (this.held) this.touch();
    else if (this.clock) this.set(this.clock.share);
    else if (this.wanted === null && !this.playing) this.set(this.loop.still);
    else if (this.loop.duration === 0) this.set(0);
    if (this.moves || this.stale) gallery.request();
  }

  set(share) {
    this.share = Math.min(Math.max(share, 0), 1);
    this.time = this.share * this.duration;
    Object.assign(this, { fade: 1, mend: 0 });
    this.touch();
  }

  // A moment by hand, or null to run on from it.
  scrub(share) {
    this.held = share !== null;
    if (this.held) this.set(share);
    this.settle();
  }

  touch() {
    this.stale = true;
    if (this.visible) gallery.request();
  }

  advance(seconds) {
    if (this.clock) return;
    this.time = (this.time + seconds) % (this.duration + HOLD + MEND);
    this.share = Math.min(this.time / this.duration, 1);
    this.mend = lessMotion.matches ? 0 : Math.max(this.time - this.duration - HOLD, 0) / MEND;
    this.fade = 1 - DIM * Math.sin(Math.PI * this.mend);
    this.stale = true;
  }

  show(visible) {
    this.visible = visible;
    if (visible) this.settle();
  }

  resize({ width, height }) {
    const ratio = pixelRatio();
    const [wide, high] = [width, height].map((size) => Math.max(Math.round(size * ratio), 1));
    if (this.canvas.width === wide && this.canvas.height === high) return;
    [this.canvas.width, this.canvas.height] = [wide, high];
    // The canvas is empty now; the page must not show it like that.
    if (this.visible) this.draw();
    else this.stale = true;
  }

  recolour() {
    this.colours = null;
    this.touch();
  }

  readColours() {
    const style = getComputedStyle(this.canvas);
    const [near, far] = MINIATURE_COLOURS.map((name) => hexColour(this.context, style, name));
    const shadow = this.context.createRadialGradient(0, 0, 0, 0, 0, 1);
    const dark = style.getPropertyValue(MINIATURE_COLOURS[2]).trim() || "transparent";
    shadow.addColorStop(0, dark);
    shadow.addColorStop(0.45, dark);
    shadow.addColorStop(1, "transparent");
    this.colours = { tones: depthTones(near, far), shadow };
  }

  draw() {
    if (!this.canvas.isConnected) return; // taken off the page: no size and no colours
    if (!this.colours) this.readColours();
    this.stale = false;
    this.painter.draw(this.loop, this.share, this.colours, this.fade, this.mend);
  }

  destroy() {
    if (!gallery.all.has(this)) return;
    gallery.remove(this);
    this.ended.abort();
    this.endClock?.();
    this.visible = false;
  }
}
