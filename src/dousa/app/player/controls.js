// Buttons, the bar of time with its marks, the words. All text goes in as text, never as markup.

const SVG = "http://www.w3.org/2000/svg";

const ICONS = {
  play: "M7 4.5v15l12.5-7.5z",
  pause: "M6 4.5h4.5v15H6zM13.5 4.5H18v15h-4.5z",
  back: "M17 5v14l-9-7zM5.5 5h2v14h-2z",
  on: "M7 5v14l9-7zM16.5 5h2v14h-2z",
  previous: "M20 5v14l-8-7zM11.5 5v14l-8-7z",
  next: "M4 5v14l8-7zM12.5 5v14l8-7z",
  loop: "M6.5 8H16V5l5 4.2-5 4.2v-3H8.5V14h-2zM17.5 16H8v3l-5-4.2 5-4.2v3h7.5V10h2z",
  reset: "M12 5V1.8L6.8 6.4 12 11V7.6a5.4 5.4 0 1 1-5.4 5.4H4a8 8 0 1 0 8-8z",
};

// Told apart by shape and letter as well as by colour.
const SHAPES = {
  global: "M2.5 2.5h19v19h-19z",
  partial: "M12 1.5a10.5 10.5 0 1 0 .01 0z",
  incomplete: "M12 1 23.5 22H.5z",
  shift: "M12 .5 23.5 12 12 23.5.5 12z",
};

function make(tag, className, parent, text) {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (text !== undefined) element.textContent = text;
  if (parent) parent.append(element);
  return element;
}

function makeShape(drawing, parent, className) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "0 0 24 24");
  svg.setAttribute("aria-hidden", "true");
  svg.setAttribute("class", className);
  const path = document.createElementNS(SVG, "path");
  path.setAttribute("d", drawing);
  svg.append(path);
  parent.append(svg);
  return path;
}

function makeMark(kind, data, parent) {
  const mark = make("span", `dp-mark dp-${kind in SHAPES ? kind : "global"}`, parent);
  makeShape(SHAPES[kind] ?? SHAPES.global, mark, "dp-shape");
  make("span", "dp-letter", mark, data.kinds[kind]?.letter ?? "?");
  mark.setAttribute("aria-hidden", "true");
  return mark;
}

function formatTime(seconds, decimals) {
  const factor = 10 ** decimals;
  const total = Math.round(Math.max(seconds, 0) * factor) / factor;
  const rest = (total % 60).toFixed(decimals).padStart(decimals ? decimals + 3 : 2, "0");
  return `${Math.floor(total / 60)}:${rest}`;
}

class Controls {
  // act: the player, whose methods the buttons call.
  constructor(root, data, act) {
    Object.assign(this, { root, data, act, duration: data.duration, words: data.texts });
    this.assessed = isAssessed(data);
    this.figures = data.reference ? ["reference", "performance"] : ["performance"];
    this.makeStage();
    this.makeTrack();
    this.makeTransport();
    this.makeViews();
    this.makeKeys();
    this.status = make("p", "dp-status", root);
    this.status.setAttribute("role", "status");
    this.status.setAttribute("aria-live", "polite");
  }

  makeStage() {
    this.stage = make("div", "dp-stage", this.root);
    this.canvas = make("canvas", "", this.stage);
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", this.words.figures);
    const names = make("div", "dp-names", this.stage);
    this.labels = {};
    this.names = {};
    for (const who of this.figures) {
      const label = make("p", `dp-name dp-name-${who}`, names);
      make("span", "dp-swatch", label).setAttribute("aria-hidden", "true");
      make("span", "dp-who", label, this.words[who]);
      this.names[who] = make("span", "dp-what", label);
      this.labels[who] = make("span", "dp-when", label);
    }
    this.nameFigures();
    this.says = make("ul", "dp-says", this.root);
    this.says.hidden = !this.assessed;
  }

  // A report names its recordings at its head; where nobody is judged the names stand over the figures.
  nameFigures() {
    for (const who of this.figures) {
      const name = this.assessed ? "" : this.data[who].name;
      this.names[who].textContent = name;
      this.names[who].title = name;
    }
  }

  // Other data for the same buttons.
  replace(data) {
    Object.assign(this, { data, duration: data.duration, shownEvents: null });
    this.nameFigures();
    this.scrub.max = this.duration;
    const focused = this.markButtons.indexOf(document.activeElement);
    this.fillTrack();
    this.layMarks();
    if (focused >= 0) (this.markButtons[focused] ?? this.root).focus({ preventScroll: true });
  }

  makeTrack() {
    const track = make("div", "dp-track", this.root);
    this.furi = make("div", "dp-furi", track);
    this.furi.setAttribute("aria-hidden", "true");
    const rail = make("div", "dp-rail", track);
    this.spanBox = make("div", "dp-spans", rail);
    this.loopBar = make("span", "dp-loopbar", rail);
    this.scrub = make("input", "dp-scrub", rail);
    Object.assign(this.scrub, { type: "range", min: 0, max: this.duration, step: "any", value: 0 });
    this.scrub.setAttribute("aria-label", this.words.time);
    this.scrub.addEventListener("input", () => this.act.seek(Number(this.scrub.value)));
    this.marks = make("div", "dp-marks", track);
    this.marks.setAttribute("role", "group");
    this.marks.setAttribute("aria-label", this.words.events);
    this.fillTrack();
  }

  fillTrack() {
    for (const box of [this.furi, this.spanBox, this.marks]) box.replaceChildren();
    this.data.furi.forEach((furi, index) => this.lay(make("span", index % 2 ? "dp-odd" : "", this.furi, furi.label), furi));
    this.spans = this.data.events.map((event) =>
      this.lay(make("span", `dp-span dp-${event.kind in SHAPES ? event.kind : "global"}`, this.spanBox), event),
    );
    this.places = this.data.events.map((event) => this.shareOf(event.worst ?? event.start));
    this.makeMarks();
  }

  shareOf(seconds) {
    return Math.min(Math.max(seconds / this.duration, 0), 1);
  }

  lay(element, { start, end }) {
    element.style.left = `${(100 * this.shareOf(start)).toFixed(3)}%`;
    element.style.width = `${(100 * (this.shareOf(end) - this.shareOf(start))).toFixed(3)}%`;
    return element;
  }

  makeMarks() {
    this.markButtons = this.data.events.map((event, index) => {
      const button = make("button", "dp-event", this.marks);
      button.type = "button";
      button.style.left = `${(100 * this.places[index]).toFixed(3)}%`;
      const label = `${this.data.kinds[event.kind]?.label ?? event.kind}: ${event.says}`;
      button.setAttribute("aria-label", label);
      button.title = label;
      makeMark(event.kind, this.data, button);
      button.addEventListener("click", () => this.act.goToEvent(index));
      return button;
    });
    this.marks.hidden = this.markButtons.length === 0;
    this.enableEvents();
  }

  // Marks that would hide each other go to rows below, three at most.
  layMarks() {
    const width = this.marks.clientWidth;
    const ends = [-Infinity, -Infinity, -Infinity];
    let used = 1;
    const places = this.places.map((place) => place * width);
    const order = places.map((_, index) => index).sort((a, b) => places[a] - places[b]);
    for (const index of order) {
      const free = ends.findIndex((end) => places[index] >= end);
      const row = free < 0 ? ends.indexOf(Math.min(...ends)) : free;
      ends[row] = places[index] + 25;
      used = Math.max(used, row + 1);
      this.markButtons[index].style.setProperty("--dp-row", row);
    }
    this.marks.style.setProperty("--dp-rows", used);
  }

  button(parent, name, key, action, options = {}) {
    const button = make("button", `dp-button ${options.className ?? ""}`, parent);
    button.type = "button";
    if (options.icon) button.path = makeShape(ICONS[options.icon], button, "dp-icon");
    if (options.text) make("span", "", button, options.text);
    button.setAttribute("aria-label", this.words[name]);
    button.title = key ? `${this.words[name]} (${key})` : this.words[name];
    button.addEventListener("click", action);
    return button;
  }

  group(parent, name) {
    const group = make("div", "dp-group", parent);
    group.setAttribute("role", "group");
    if (name) group.setAttribute("aria-label", this.words[name]);
    return group;
  }

  makeTransport() {
    const { act, words } = this;
    const bar = make("div", "dp-bar", this.root);
    const group = this.group(bar, "player");
    this.previous = this.button(group, "previous", "P", () => act.goBeside(-1), { icon: "previous" });
    this.button(group, "back", "←", () => act.stepFrames(-1), { icon: "back" });
    this.play = this.button(group, "play", words.space, () => act.toggle(), { icon: "play", className: "dp-play" });
    this.button(group, "on", "→", () => act.stepFrames(1), { icon: "on" });
    this.next = this.button(group, "next", "N", () => act.goBeside(1), { icon: "next" });
    this.clock = make("span", "dp-clock", bar);
    const speeds = this.group(bar, "speed");
    speeds.classList.add("dp-choice");
    this.speeds = SPEEDS.map((speed) => {
      const button = this.button(speeds, "speed", "[ ]", () => act.setSpeed(speed), { text: `${speed}×` });
      button.setAttribute("aria-label", `${words.speed} ${speed}×`);
      return button;
    });
    this.loop = this.button(bar, "loop", "L", () => act.toggleLoop(), { icon: "loop", text: words.loop });
    for (const button of [this.previous, this.next]) button.hidden = !this.assessed;
    this.enableEvents();
  }

  enableEvents() {
    const none = this.assessed && this.data.events.length === 0;
    for (const button of [this.previous, this.next, this.loop]) if (button) button.disabled = none;
  }

  // Buttons of which one is pressed: words, and what each sets the view's `part` to.
  choice(bar, name, key, part, values) {
    const group = this.group(bar, name);
    group.classList.add("dp-choice");
    return Object.entries(values).map(([word, value]) => {
      const button = this.button(group, word, key, () => this.act.setView({ [part]: value }), { text: this.words[word] });
      button.value = value;
      return button;
    });
  }

  makeViews() {
    const { act, words } = this;
    const bar = make("div", "dp-bar dp-views", this.root);
    this.modes = this.choice(bar, "arrangement", "O", "mode", { side: "side", over: "over" });
    this.syncs = this.choice(bar, "timing", "S", "sync", { step: "step", real: "time" });
    for (const choice of [this.modes, this.syncs]) choice[0].parentElement.hidden = !this.data.reference;
    const toggles = this.group(bar, "");
    this.mirror = this.button(toggles, "mirror", "M", () => act.flip("mirror"), { text: words.mirror });
    this.place = this.button(toggles, "place", "I", () => act.flip("inPlace"), { text: words.place });
    const views = this.group(bar, "view");
    ["front", "flank", "top"].forEach((name, index) => {
      this.button(views, name, String(index + 1), () => act.look(name), { text: words[name] });
    });
    this.button(views, "reset", "0", () => act.look(null), { icon: "reset" });
  }

  makeKeys() {
    const { words } = this;
    const details = make("details", "dp-keys", this.root);
    make("summary", "", details, words.keys);
    const list = make("dl", "", details);
    const rows = [
      [words.space, "keyPlay"], ["← →", "keyFrame"], ["[ ]", "keySpeed"],
      ...(this.assessed ? [["N P", "keyEvent"]] : []), ["L", "keyLoop"],
      ...(this.data.reference ? [["O", "keySide"], ["S", "keyStep"]] : []),
      ["M", "keyMirror"], ["I", "keyPlace"], ["1 2 3", "keyView"], ["0", "keyReset"], ["Home End", "keyHome"],
    ];
    for (const [keys, name] of rows) {
      const row = make("div", "", list);
      const term = make("dt", "", row);
      for (const key of keys.split(" ")) make("kbd", "", term, key);
      make("dd", "", row, words[name]);
    }
    make("p", "", details, words.mouse);
  }

  // state: time, referenceTime, seen, playing, speed, looped, view, current (events at this moment).
  update(state) {
    const { words } = this;
    this.clock.textContent = `${formatTime(state.time, 2)} / ${formatTime(this.duration, 2)}`;
    if (document.activeElement !== this.scrub || Number(this.scrub.value) !== state.time) {
      this.scrub.value = state.time;
    }
    this.scrub.style.setProperty("--dp-done", `${((100 * state.time) / this.duration).toFixed(3)}%`);
    this.scrub.setAttribute("aria-valuetext", formatTime(state.time, 1));
    this.labels.performance.textContent = formatTime(state.time, 1);
    if (this.labels.reference) {
      this.labels.reference.textContent = state.seen ? formatTime(state.referenceTime, 1) : words.absent;
    }
    this.updateButtons(state);
    this.updateEvents(state);
    this.loopBar.hidden = !state.looped;
    if (state.looped) this.lay(this.loopBar, { start: state.looped[0], end: state.looped[1] });
  }

  updateButtons(state) {
    const press = (button, pressed) => button.setAttribute("aria-pressed", String(pressed));
    if (this.wasPlaying !== state.playing) {
      this.wasPlaying = state.playing;
      const name = state.playing ? "pause" : "play";
      this.play.path.setAttribute("d", ICONS[name]);
      this.play.setAttribute("aria-label", this.words[name]);
      this.play.title = `${this.words[name]} (${this.words.space})`;
    }
    this.speeds.forEach((button, index) => press(button, SPEEDS[index] === state.speed));
    for (const button of this.modes) press(button, button.value === state.view.mode);
    for (const button of this.syncs) press(button, button.value === state.view.sync);
    press(this.mirror, state.view.mirror);
    press(this.place, state.view.inPlace);
    press(this.loop, Boolean(state.looped));
    this.root.dataset.mode = this.data.reference ? state.view.mode : "single";
    this.root.classList.toggle("dp-absent", !state.seen);
  }

  updateEvents(state) {
    const key = state.current.join();
    if (key === this.shownEvents) return;
    this.shownEvents = key;
    this.markButtons.forEach((button, index) => {
      const here = state.current.includes(index);
      button.classList.toggle("dp-here", here);
      this.spans[index].classList.toggle("dp-here", here);
      if (here) button.setAttribute("aria-current", "true");
      else button.removeAttribute("aria-current");
    });
    this.says.replaceChildren();
    for (const index of state.current) {
      const event = this.data.events[index];
      const line = make("li", "", this.says);
      makeMark(event.kind, this.data, line);
      const text = make("span", "", line);
      make("strong", "", text, this.data.kinds[event.kind]?.label ?? event.kind);
      text.append(" ", event.says);
    }
    if (!state.current.length) {
      make("li", "dp-none", this.says, this.data.events.length ? this.words.noEvent : this.words.noEvents);
    }
  }
}
