// new Timeline(element, options): a stretch of time with labels, a cursor, a part, cuts.
//
//   options: {duration (s), segments: [{start, end, label, kind: "known" | "perhaps" | "unknown" | "corrected", confidence}],
//     cuts: [s], selectable: a part can be chosen, editable: cuts can be moved, added and taken away,
//     label: what it shows (for screen readers), onSeek(s), onSelect({start, end, of: label that was chosen} or null, done),
//     onCuts([s], done), onSpace()}. These are called for what people do, not for the setters; done is false while
//     something is being dragged.
//   timeline.setCursor(s) .setSegments(segments) .setSelection(start, end, of) .setSelection(null) .setCuts([s])
//     .showPart(s): the part with this moment, .destroy()
//   Segments at one time lie in lanes, one below the other.
//   to read, not to change: .cursor .selection .cuts .duration .element .tones (for makeLegend of timeline_parts.js)
//
// Keys on the cursor: arrows (with Shift a part is chosen), Page Up/Down, Home/End, [ and ] set the ends of the part,
// Escape lets it go, + and - zoom, C cuts. On a cut or an end: arrows move, Delete takes a cut away.

import { formatSeconds, h, onDrag, t } from "./dom.js";
import { describeSegment, drawStrip, findLanes, makeSegment, makeTicks, place, Tones } from "./timeline_parts.js";

// The whole of a timeline in little, while only a part of it is seen; click or drag to see another part.
class Overview {
  /** scroll: the element that scrolls; onGo(share): the middle of what is to be seen. */
  constructor(scroll, onGo) {
    this.scroll = scroll;
    this.strip = h("div", { class: "tl-strip" });
    this.frame = h("div", { class: "tl-frame" });
    this.element = h("div", { class: "tl-overview", hidden: true, "aria-hidden": "true" }, this.strip, this.frame);
    onDrag(this.element, onGo);
    scroll.addEventListener("scroll", () => this.place(), { passive: true });
  }

  draw(segments, duration, tones) {
    drawStrip(this.strip, segments, duration, tones);
  }

  place() {
    const { scrollLeft, clientWidth, scrollWidth } = this.scroll;
    this.element.hidden = scrollWidth <= clientWidth + 2;
    Object.assign(this.frame.style, place(scrollLeft, scrollLeft + clientWidth, scrollWidth));
  }
}

const STEP = 0.1; // s of an arrow key
const LEAST = 0.1; // s of a part, and between cuts
const [LONG, SEEN, BEFORE] = [150, 75, 10]; // s: of a longer recording so much is shown at first, from so long before
const CLICK = 5; // px that a click may move
const MOST_PIXELS_A_SECOND = 240;
const MOST_LANES = 6; // for which the timeline grows: of more, each is lower

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

export class Timeline {
  constructor(element, { duration, segments = [], cuts = [], selectable = false, editable = false, label, onSeek, onSelect, onCuts, onSpace }) {
    Object.assign(this, { duration: Math.max(duration, 1e-3), segments, selectable, editable, zoom: 1, onSeek, onSelect, onCuts, onSpace });
    Object.assign(this, { cursor: 0, selection: null, cuts: [...cuts], tones: new Tones(), dragging: false });
    this.name = label ?? t("timeline");
    this.build(element);
    this.watcher = new ResizeObserver(() => this.measure());
    this.watcher.observe(this.scroll);
    this.draw();
  }

  build(element) {
    this.ruler = h("div", { class: "tl-ruler", "aria-hidden": "true" });
    this.track = h("div", { class: "tl-track", "aria-hidden": "true" });
    this.part = h("div", { class: "tl-part", hidden: true });
    this.ends = ["start", "end"].map((name) => this.makeEnd(name));
    this.marks = h("div", { class: "tl-cuts" });
    this.hand = h("div", { class: "tl-cursor", tabindex: "0", role: "slider", "aria-label": this.name, "aria-keyshortcuts": "[ ] Escape + -" });
    this.hand.addEventListener("keydown", (event) => this.pressCursor(event));
    this.inner = h("div", { class: "tl-inner" }, this.ruler, this.track, this.part, this.marks, ...this.ends, this.hand);
    this.scroll = h("div", { class: "tl-scroll" }, this.inner);
    this.overview = new Overview(this.scroll, (share) => (this.scroll.scrollLeft = share * this.scroll.scrollWidth - this.scroll.clientWidth / 2));
    this.element = h("div", { class: "tl", role: "group", "aria-label": this.name }, this.overview.element, this.scroll, this.makeBar());
    element.replaceChildren(this.element);
    this.element.addEventListener("keydown", (event) => {
      if (event.key !== " " || !this.onSpace || event.target.closest("button")) return;
      event.preventDefault();
      this.onSpace();
    });
    this.inner.addEventListener("pointerdown", (event) => this.grab(event));
    this.track.addEventListener("dblclick", (event) => this.chooseSegment(event));
    this.scroll.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
  }

  makeBar() {
    const button = (name, action, text) => h("button", { type: "button", class: "small quiet", onclick: action, title: t(name), "aria-label": text ? t(name) : null, dataset: { act: name } }, text ?? t(name));
    const zoom = [
      button("timeline_out", () => this.setZoom(this.zoom / 2), "−"),
      button("timeline_in", () => this.setZoom(this.zoom * 2), "+"),
      button("timeline_fit", () => this.setZoom(1)),
    ];
    const part = this.selectable
      ? [
          button("timeline_start_here", () => this.setEndHere(0)),
          button("timeline_end_here", () => this.setEndHere(1)),
          button("timeline_clear", () => this.select(null, true)),
        ]
      : [];
    const cuts = this.editable ? [button("timeline_cut", () => this.addCut(this.cursor))] : [];
    this.says = h("output", { class: "tl-says" });
    return h("div", { class: "tl-bar" }, ...part, ...cuts, this.says, h("span", { class: "tl-zoom" }, ...zoom));
  }

  makeEnd(name) {
    const at = name === "start" ? 0 : 1;
    const end = h("div", { class: `tl-end tl-end-${name}`, tabindex: "0", role: "slider", "aria-label": t(`timeline_${name}`), hidden: true });
    end.addEventListener("keydown", (event) => this.pressMark(event, (by) => this.setEnd(at, this.selectionEnds()[at] + by), null));
    this.drag(end, (seconds, done) => this.setEnd(at, seconds, done));
    return end;
  }

  draw() {
    this.inner.style.width = `${100 * this.zoom}%`;
    this.measure();
    this.drawSegments();
    this.drawCuts();
    this.drawSelection();
    this.drawCursor();
  }

  measure() {
    this.overview.place();
    const width = this.inner.clientWidth;
    const key = `${width} ${this.duration}`;
    if (!width || key === this.drawn) return;
    this.drawn = key;
    this.ruler.replaceChildren(...makeTicks(this.duration, width));
  }

  drawSegments() {
    const lanes = findLanes(this.segments);
    this.inner.style.setProperty("--lanes", Math.min(Math.max(1, ...lanes.map((one) => one.lanes)), MOST_LANES));
    this.track.replaceChildren(...this.segments.map((one, number) => makeSegment(one, this.duration, this.tones, lanes[number])));
    this.overview.draw(this.segments, this.duration, this.tones);
  }

  drawCuts() {
    const focused = [...this.marks.children].indexOf(document.activeElement);
    this.marks.replaceChildren(...this.cuts.map((seconds, number) => this.makeCut(seconds, number)));
    if (focused >= 0) this.marks.children[Math.min(focused, this.cuts.length - 1)]?.focus();
  }

  makeCut(seconds, number) {
    const cut = h("div", { class: `tl-cut${this.editable ? "" : " tl-fixed"}`, title: formatSeconds(seconds) });
    this.setSlider(cut, seconds, formatSeconds(seconds));
    cut.setAttribute("aria-label", t("timeline_cut_number", { number: number + 1 }));
    if (!this.editable) return cut;
    cut.tabIndex = 0;
    cut.setAttribute("role", "slider");
    cut.addEventListener("keydown", (event) => this.pressMark(event, (by) => this.moveCut(number, this.cuts[number] + by, true), () => this.removeCut(number)));
    cut.addEventListener("dblclick", () => this.removeCut(number));
    this.drag(cut, (where, done) => this.moveCut(number, where, done));
    return cut;
  }

  setSlider(element, seconds, text) {
    const values = { valuemin: 0, valuemax: this.duration.toFixed(2), valuenow: seconds.toFixed(2), valuetext: text };
    for (const [name, value] of Object.entries(values)) element.setAttribute(`aria-${name}`, value);
    element.style.left = `${(100 * seconds) / this.duration}%`;
  }

  drawSelection() {
    const { selection } = this;
    for (const element of [this.part, ...this.ends]) element.hidden = !selection;
    this.element.classList.toggle("tl-chosen", Boolean(selection));
    if (selection) {
      Object.assign(this.part.style, place(selection.start, selection.end, this.duration));
      this.selectionEnds().forEach((seconds, at) => this.setSlider(this.ends[at], seconds, formatSeconds(seconds)));
    }
    this.say();
  }

  drawCursor() {
    const text = [formatSeconds(this.cursor), ...this.segmentsAt(this.cursor).map(describeSegment)].join(", ");
    this.setSlider(this.hand, this.cursor, text);
    this.say();
  }

  say() {
    const { selection } = this;
    const span = selection ? t("timeline_part", { start: formatSeconds(selection.start), end: formatSeconds(selection.end) }) : "";
    const text = span || (this.selectable ? t("timeline_hint") : "");
    if (this.says.textContent !== text) this.says.textContent = text;
  }

  seconds({ clientX }) {
    const { left, width } = this.inner.getBoundingClientRect();
    return clamp(((clientX - left) / width) * this.duration, 0, this.duration);
  }

  seek(seconds) {
    this.setCursor(clamp(seconds, 0, this.duration));
    this.onSeek?.(this.cursor);
  }

  select(part, done) {
    this.selection = part;
    this.drawSelection();
    this.onSelect?.(part, done);
  }

  selectionEnds() {
    return this.selection ? [this.selection.start, this.selection.end] : [0, this.duration];
  }

  setEnd(at, seconds, done = true) {
    const ends = this.selectionEnds();
    ends[at] = at === 0 ? clamp(seconds, 0, ends[1] - LEAST) : clamp(seconds, ends[0] + LEAST, this.duration);
    this.select({ ...this.selection, start: ends[0], end: ends[1] }, done);
  }

  /** The part begins or ends at the cursor; where its other end lies on the wrong side, that goes. */
  setEndHere(at) {
    const [start, end] = this.selectionEnds();
    if (at === 0 ? this.cursor > end - LEAST : this.cursor < start + LEAST) this.selection = null;
    this.setEnd(at, this.cursor);
  }

  /** Anything on the timeline: a click seeks, dragging over the labels chooses, dragging along the ruler seeks. */
  grab(event) {
    if (event.button !== 0 || event.target.closest(".tl-end, .tl-cut:not(.tl-fixed)")) return;
    const from = this.seconds(event);
    const chooses = this.selectable && event.pointerType !== "touch" && !event.target.closest(".tl-ruler, .tl-cursor");
    let moved = false;
    this.follow(event, (now, done) => {
      moved ||= Math.abs(now.clientX - event.clientX) > CLICK;
      const to = this.seconds(now);
      if (!moved || !chooses) {
        this.seek(to);
      } else if (Math.abs(to - from) >= LEAST) {
        this.select({ start: Math.min(from, to), end: Math.max(from, to) }, done);
      }
    });
    if (event.pointerType !== "touch") this.hand.focus({ preventScroll: true });
  }

  /** onMove(event, done) until the pointer is let go. */
  follow(event, onMove) {
    this.dragging = true;
    const id = event.pointerId;
    if (event.pointerType !== "touch") event.preventDefault();
    const move = (now) => now.pointerId === id && onMove(now, false);
    const end = (now) => {
      if (now.pointerId !== id) return;
      this.dragging = false;
      for (const [name, action] of handlers) window.removeEventListener(name, action);
      if (now.type === "pointerup") onMove(now, true);
    };
    const handlers = [["pointermove", move], ["pointerup", end], ["pointercancel", end]];
    for (const [name, action] of handlers) window.addEventListener(name, action);
  }

  drag(element, act) {
    element.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      event.stopPropagation();
      event.preventDefault();
      element.focus({ preventScroll: true });
      this.follow(event, (now, done) => act(this.seconds(now), done));
    });
  }

  chooseSegment(event) {
    const shown = event.target.closest(".tl-segment"); // of several at one time the one that was meant
    const segment = shown ? this.segments[[...this.track.children].indexOf(shown)] : this.segmentsAt(this.seconds(event)).at(-1);
    if (this.selectable && segment) this.select({ start: segment.start, end: segment.end, of: segment.label }, true);
  }

  segmentsAt(seconds) {
    return this.segments.filter((one) => one.start <= seconds && seconds < one.end);
  }

  wheel(event) {
    if (!event.ctrlKey && !event.metaKey) return;
    event.preventDefault();
    this.setZoom(this.zoom * (event.deltaY < 0 ? 1.25 : 0.8), this.seconds(event));
  }

  pressCursor(event) {
    const page = this.duration / this.zoom / 10;
    const moves = { ArrowLeft: -STEP, ArrowRight: STEP, ArrowDown: -STEP, ArrowUp: STEP, PageDown: -page, PageUp: page, Home: -Infinity, End: Infinity };
    const acts = {
      "[": () => this.selectable && this.setEndHere(0),
      "]": () => this.selectable && this.setEndHere(1),
      Escape: () => this.selection && this.select(null, true),
      "+": () => this.setZoom(this.zoom * 2),
      "-": () => this.setZoom(this.zoom / 2),
      c: () => this.editable && this.addCut(this.cursor),
    };
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key in moves) this.step(moves[event.key], event.shiftKey && this.selectable);
    else if (event.key in acts) acts[event.key]();
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  step(by, chooses) {
    const from = this.cursor;
    this.seek(clamp(from + by, 0, this.duration));
    if (!chooses || !this.selection) this.anchor = from;
    if (!chooses) return;
    const [start, end] = [this.anchor, this.cursor].sort((a, b) => a - b);
    this.select(end - start < LEAST / 2 ? null : { start, end }, true);
  }

  pressMark(event, move, remove) {
    const moves = { ArrowLeft: -STEP, ArrowRight: STEP, ArrowDown: -STEP, ArrowUp: STEP, PageDown: -1, PageUp: 1 };
    if (event.key in moves) move(moves[event.key]);
    else if (remove && (event.key === "Delete" || event.key === "Backspace")) remove();
    else if (event.key === "Escape" && this.selection) this.select(null, true);
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  moveCut(number, seconds, done) {
    const [low, high] = [(this.cuts[number - 1] ?? 0) + LEAST, (this.cuts[number + 1] ?? this.duration) - LEAST];
    this.cuts[number] = clamp(seconds, low, high);
    const mark = this.marks.children[number];
    this.setSlider(mark, this.cuts[number], formatSeconds(this.cuts[number]));
    this.onCuts?.([...this.cuts], done);
  }

  addCut(seconds) {
    const edges = [0, ...this.cuts, this.duration];
    if (edges.some((edge) => Math.abs(edge - seconds) < LEAST)) return;
    this.setCuts([...this.cuts, seconds].sort((a, b) => a - b));
    this.onCuts?.([...this.cuts], true);
  }

  removeCut(number) {
    this.cuts.splice(number, 1);
    this.drawCuts();
    if (!this.cuts.length) this.hand.focus({ preventScroll: true });
    this.onCuts?.([...this.cuts], true);
  }

  setCursor(seconds) {
    this.cursor = clamp(seconds, 0, this.duration);
    this.drawCursor();
    if (this.zoom > 1 && !this.dragging) this.bringIntoView();
  }

  bringIntoView() {
    const [x, width] = [(this.cursor / this.duration) * this.inner.clientWidth, this.scroll.clientWidth];
    const left = this.scroll.scrollLeft;
    if (x < left + 8 || x > left + width - 8) this.scroll.scrollLeft = x - width / 4;
  }

  setZoom(zoom, around = this.cursor) {
    const width = this.scroll.clientWidth || 1;
    const most = Math.max((this.duration * MOST_PIXELS_A_SECOND) / width, 1);
    const before = (around / this.duration) * this.inner.clientWidth - this.scroll.scrollLeft;
    this.zoom = clamp(zoom, 1, most);
    this.inner.style.width = `${100 * this.zoom}%`;
    this.scroll.scrollLeft = (around / this.duration) * width * this.zoom - clamp(before, 0, width);
    this.measure();
  }

  show(start, end) {
    this.setZoom(this.duration / Math.max(end - start, LEAST), start);
    this.scroll.scrollLeft = (start / this.duration) * this.inner.clientWidth;
  }

  /** Of a long recording a part is shown, from a little before a moment of it. */
  showPart(moment) {
    const from = Math.max(moment - BEFORE, 0);
    if (this.duration > LONG) this.show(from, from + SEEN);
  }

  setSegments(segments) {
    this.segments = segments;
    this.drawSegments();
    this.drawCursor();
  }

  setSelection(start, end, of) {
    const inside = (seconds) => clamp(seconds, 0, this.duration);
    this.selection = start == null ? null : { start: inside(start), end: inside(end), ...(of && { of }) };
    this.drawSelection();
  }

  setCuts(cuts) {
    this.cuts = [...cuts];
    this.drawCuts();
  }

  destroy() {
    this.watcher.disconnect();
    this.element.remove();
  }
}
