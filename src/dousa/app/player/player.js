// dousa.createPlayer(element, data, options) -> player
//
// Two figures, a reference and a performance, or the performance alone, on one canvas. Times are seconds of the
// performance. options.pageKeys false: keys are taken only inside the player, not from the bare page.
//   player.seek(seconds) .play() .pause() .toggle() .loop(start, end) .loop(null) .setSpeed(factor)
//   player.setView({mode: "side" | "over", sync: "step" | "time", mirror: bool, inPlace: bool}), each optional
//   player.onTime(callback) -> function that stops the calls; callback(seconds) after every change
//   player.replace(data, {live: bool}): other data in the same player; view, time, speed and playing stay. With live a
//     recording has grown: the room never shrinks, and who stands at the end stays there
//   player.reveal(): scroll so far that all of it is seen, or its upper end where the window is too low
//   player.destroy(); and to read: player.time .duration .playing .speed .view .looped

const SPEEDS = [0.25, 0.5, 1, 2];
const LONGEST_STEP = 0.25; // s: after the page slept, play goes on from where it stood
const [REST, RETURN] = [0.15, 0.4]; // s a loop of one motion rests at its end, and takes to come back to its beginning
const QUIET = 400; // ms without change before a screen reader is told the time

const ALONE = { time: 0, seen: true }; // the match where there is nobody to match

const mixPlaces = (a, b, share) => a.map((value, k) => value + share * (b[k] - value));

const players = []; // the one used last comes first: it gets the keys that nobody else wants

function isAssessed(data) {
  return data.assessed !== false;
}

// Equal for data that need the same words and buttons.
function describeFurniture(data) {
  return JSON.stringify([data.language, data.texts, data.kinds, isAssessed(data), Boolean(data.reference)]);
}

class Player {
  constructor(element, data, options) {
    this.joints = { reference: new Float64Array(VALUES), performance: new Float64Array(VALUES) };
    this.first = new Float64Array(VALUES);
    Object.assign(this, { time: 0, turned: 0, playing: false, speed: 1, looped: null, listeners: new Set(), waiting: 0 });
    this.view = { mode: "side", sync: "step", mirror: false, inPlace: true };
    this.pageKeys = options.pageKeys !== false;
    this.load(data);
    this.build(element);
    players.unshift(this);
    this.request();
  }

  load(data) {
    const clips = { performance: new Clip(data.performance, data.rate) };
    if (data.reference) {
      clips.reference = new Clip(data.reference, data.rate);
      this.matches = { step: new Match(data.step, data.rate), time: new Match(data.time, data.rate) };
    }
    this.data = data;
    this.clips = clips;
    this.duration = Math.max((data.performance.n_frames - 1) / data.rate, 1e-3);
    this.measureTravel();
  }

  build(element) {
    this.root = make("div", "dousa-player", element);
    this.root.tabIndex = 0;
    this.root.setAttribute("role", "group");
    this.onKey = (event) => {
      if (players.find((player) => player.root.isConnected && player.takes(event)) === this) this.press(event);
    };
    document.addEventListener("keydown", this.onKey);
    this.root.addEventListener("pointerdown", () => this.comeFirst());
    this.root.addEventListener("focusin", () => this.comeFirst());
    this.furnish();
  }

  // Everything inside; done anew when other data need other words or other buttons.
  furnish() {
    const camera = this.stage?.camera;
    const held = this.root.contains(document.activeElement);
    this.stage?.destroy();
    this.root.replaceChildren();
    this.root.setAttribute("aria-label", this.data.texts.player);
    if (this.data.language) this.root.lang = this.data.language;
    this.controls = new Controls(this.root, { ...this.data, duration: this.duration }, this);
    this.stage = new Stage(this.root, this.controls.canvas, () => {
      this.controls.layMarks();
      this.request();
    });
    if (camera) this.stage.camera = camera;
    if (held) this.root.focus({ preventScroll: true });
    this.furniture = describeFurniture(this.data);
  }

  replace(data, { live = false } = {}) {
    if (this.dead) return;
    const { clips, duration } = this;
    const whole = this.looped && this.looped[0] === 0 && this.looped[1] >= duration - 1e-6;
    const atEnd = this.time >= duration - 1e-6;
    this.load(data);
    if (live) for (const [name, clip] of Object.entries(this.clips)) clip.keepRoom(clips[name]);
    if (describeFurniture(data) === this.furniture) this.controls.replace({ ...data, duration: this.duration });
    else this.furnish();
    if (this.looped) this.loop(this.looped[0], whole ? this.duration : this.looped[1]);
    this.seek(live && atEnd ? this.duration : this.time);
  }

  reveal() {
    const box = this.root.getBoundingClientRect();
    const head = parseFloat(getComputedStyle(document.documentElement).scrollPaddingTop) || 0;
    if (box.top >= head && box.bottom <= window.innerHeight) return;
    this.root.scrollIntoView({ block: box.height > window.innerHeight - head ? "start" : "nearest" });
  }

  comeFirst() {
    players.splice(players.indexOf(this), 1);
    players.unshift(this);
  }

  // A little travel fits the picture; a camera that stands still shows it best. Far travel is followed.
  measureTravel() {
    const bounds = Object.values(this.clips).map((clip) => clip.bounds);
    const low = [0, 1].map((k) => Math.min(...bounds.map((each) => each.low[k])));
    const high = [0, 1].map((k) => Math.max(...bounds.map((each) => each.high[k])));
    this.middle = [0, 1].map((k) => (low[k] + high[k]) / 2);
    this.travel = Math.hypot(high[0] - low[0], high[1] - low[1]) / 2;
    this.follow = this.travel > 1.6;
  }

  seek(seconds) {
    if (!Number.isFinite(seconds)) return;
    this.time = Math.min(Math.max(seconds, 0), this.duration);
    this.turned = 0;
    this.tell();
  }

  play() {
    if (this.playing) return;
    const [start, end] = this.looped ?? [0, this.duration];
    if (this.time >= end - 1e-6) this.time = start;
    this.turned = 0;
    this.playing = true;
    this.clock = null;
    this.tell();
  }

  pause() {
    if (!this.playing) return;
    this.playing = false;
    this.tell();
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  setSpeed(speed) {
    if (!(speed > 0) || !Number.isFinite(speed)) return;
    this.speed = speed;
    this.request();
  }

  loop(start, end) {
    const valid = Number.isFinite(start) && Number.isFinite(end) && Math.min(end, this.duration) > Math.max(start, 0);
    this.turned = 0;
    this.looped = valid ? [Math.max(start, 0), Math.min(end, this.duration)] : null;
    if (this.looped && (this.time < this.looped[0] || this.time >= this.looped[1])) this.time = this.looped[0];
    this.tell();
  }

  toggleLoop() {
    if (this.looped) return this.loop(null);
    if (!isAssessed(this.data)) return this.loop(0, this.duration);
    const index = this.currentEvents()[0] ?? this.nearestEvent();
    if (index !== undefined) this.loop(this.data.events[index].start, this.data.events[index].end);
  }

  stepFrames(count) {
    this.pause();
    this.seek((Math.round(this.time * this.data.rate) + count) / this.data.rate);
  }

  currentEvents() {
    const isNow = ({ start, end }) => this.time >= start - 1e-6 && this.time <= end + 1e-6;
    return [...this.data.events.keys()].filter((index) => isNow(this.data.events[index]));
  }

  nearestEvent() {
    const gap = ({ start, end }) => Math.max(start - this.time, this.time - end, 0);
    const order = this.data.events.map((_, index) => index);
    return order.sort((a, b) => gap(this.data.events[a]) - gap(this.data.events[b]))[0];
  }

  // A still picture shows the worst moment; a moving one the whole event from its start.
  anchor(event) {
    return this.playing ? event.start : (event.worst ?? event.start);
  }

  goToEvent(index) {
    const event = this.data.events[index];
    if (!event) return;
    if (this.looped) this.loop(event.start, event.end);
    this.seek(this.anchor(event));
  }

  goBeside(direction) {
    const anchors = this.data.events.map((event) => this.anchor(event));
    // While it plays, "previous" shortly after a start means the one before.
    const slack = this.playing && direction < 0 ? 1.0 : 1e-3;
    let best = -1;
    anchors.forEach((time, index) => {
      if (direction * (time - this.time) <= slack) return;
      if (best < 0 || direction * (time - anchors[best]) < 0) best = index;
    });
    if (best >= 0) this.goToEvent(best);
  }

  setView(view) {
    const allowed = { mode: ["side", "over"], sync: ["step", "time"], mirror: [true, false], inPlace: [true, false] };
    for (const [name, values] of Object.entries(allowed)) {
      if (values.includes(view?.[name])) this.view[name] = view[name];
    }
    this.request();
  }

  flip(name) {
    this.setView({ [name]: !this.view[name] });
  }

  look(name) {
    if (name) this.stage.camera.look(name);
    else this.stage.camera.reset();
    this.request();
  }

  takes(event) {
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey) return false;
    const { target } = event;
    const free = target === document.body || target === document.documentElement;
    return (free && this.pageKeys) || this.root.contains(target);
  }

  press(event) {
    const { target } = event;
    const button = target.closest?.("button, summary");
    if (button && (event.key === " " || event.key === "Enter")) return;
    const arrow = (sign) => (event.shiftKey ? this.seek(this.time + sign) : this.stepFrames(sign));
    const keys = {
      " ": () => this.toggle(),
      ArrowLeft: () => arrow(-1),
      ArrowRight: () => arrow(1),
      "[": () => this.changeSpeed(-1),
      "]": () => this.changeSpeed(1),
      l: () => this.toggleLoop(),
      m: () => this.flip("mirror"),
      i: () => this.flip("inPlace"),
      o: () => this.setView({ mode: this.view.mode === "side" ? "over" : "side" }),
      s: () => this.setView({ sync: this.view.sync === "step" ? "time" : "step" }),
      n: () => this.goBeside(1),
      p: () => this.goBeside(-1),
      1: () => this.look("front"),
      2: () => this.look("flank"),
      3: () => this.look("top"),
      0: () => this.look(null),
    };
    if (this.root.contains(target)) {
      keys.Home = () => this.seek(this.looped ? this.looped[0] : 0);
      keys.End = () => this.seek(this.duration);
    }
    const action = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }

  changeSpeed(direction) {
    const sorted = direction > 0 ? SPEEDS : [...SPEEDS].reverse();
    this.setSpeed(sorted.find((speed) => direction * (speed - this.speed) > 1e-9) ?? this.speed);
  }

  tell() {
    for (const callback of [...this.listeners]) callback(this.time);
    this.request();
  }

  request() {
    if (!this.waiting && !this.dead) this.waiting = requestAnimationFrame((now) => this.tick(now));
  }

  tick(now) {
    this.waiting = 0;
    if (this.playing) {
      if (this.clock !== null) this.advance(Math.min((now - this.clock) / 1000, LONGEST_STEP) * this.speed);
      this.clock = now;
    }
    this.render();
    if (this.playing) this.request();
  }

  // What is judged jumps back to its beginning: film and music beside it do so too.
  advance(seconds) {
    const [start, end] = this.looped ?? [0, this.duration];
    const over = this.time + this.turned + seconds - end;
    const pause = this.looped && !isAssessed(this.data) ? REST + RETURN : 0;
    if (over < 0) {
      this.time += seconds;
    } else if (!this.looped) {
      this.time = this.duration;
      this.playing = false;
    } else if (over < pause) {
      Object.assign(this, { time: end, turned: over });
    } else {
      Object.assign(this, { time: start + Math.min(over - pause, end - start) * 0.999, turned: 0 });
    }
    for (const callback of [...this.listeners]) callback(this.time);
  }

  // How far a loop has come back to its beginning, 0 to 1, slow at both ends.
  get back() {
    return ease(Math.max(this.turned - REST, 0) / RETURN);
  }

  matchAt(time) {
    return this.clips.reference ? this.matches[this.view.sync].at(time) : ALONE;
  }

  render() {
    const match = this.matchAt(this.time);
    const { back } = this;
    const begin = back ? { performance: this.looped[0], reference: this.matchAt(this.looped[0]).time } : null;
    const current = this.currentEvents();
    const wrong = new Set(current.flatMap((index) => this.data.events[index].segments));
    const figure = (name, time) => {
      const clip = this.clips[name];
      const at = (wanted, joints) => ({ gone: clip.sample(wanted, joints), home: this.follow ? clip.smoothPlace(wanted) : this.middle });
      let { gone, home } = at(time, this.joints[name]);
      if (begin) {
        const other = at(begin[name], this.first);
        mixJoints(this.joints[name], this.first, back);
        [gone, home] = [mixPlaces(gone, other.gone, back), mixPlaces(home, other.home, back)];
      }
      const place = this.view.inPlace ? [0, 0] : gone;
      return { clip, place, home, body: buildBody(this.joints[name], clip.scale, clip.absent) };
    };
    const reference = this.clips.reference ? figure("reference", match.time) : null;
    const performance = figure("performance", this.time);
    const { time, playing, speed, looped, view, follow, travel } = this;
    this.stage.draw({ reference, performance, seen: match.seen, view, follow, travel, wrong });
    this.controls.update({ time, referenceTime: match.time, seen: match.seen, playing, speed, looped, view, current });
    this.announceLater();
  }

  // Screen readers hear the time when it rests, and whether it runs; not every frame.
  announceLater() {
    clearTimeout(this.timer);
    if (this.playing && this.announced === "playing") return;
    this.timer = setTimeout(() => {
      const words = this.data.texts;
      this.announced = this.playing ? "playing" : "paused";
      const says = this.currentEvents().map((index) => this.data.events[index].says);
      this.controls.status.textContent = this.playing
        ? words.playing
        : [formatTime(this.time, 1), words.paused, ...says].join(", ");
    }, this.playing ? 0 : QUIET);
  }

  destroy() {
    if (this.dead) return;
    this.dead = true;
    this.playing = false;
    cancelAnimationFrame(this.waiting);
    clearTimeout(this.timer);
    document.removeEventListener("keydown", this.onKey);
    this.stage.destroy();
    this.root.remove();
    this.listeners.clear();
    players.splice(players.indexOf(this), 1);
  }
}
