// The panes of the page: how wide they are, how large the figures, grid or list, remembered in this browser; or the map.

import { $, h, keep, recall, t } from "../core/dom.js";
import { fromAddress, inAddress } from "./places.js";

// What the list of clips scrolls in: a pane of its own where the window is large, the page where it is small.
const LARGE = window.matchMedia("(min-width: 861px) and (min-height: 560px)"); // as in library.css
const [BELOW_HEAD, ABOVE_FOOT] = [132, 84]; // px of the page's head, and of the bar of actions

export class Scroll {
  constructor(pane) {
    this.pane = pane;
  }

  get isPane() {
    return LARGE.matches;
  }

  get top() {
    return this.isPane ? this.pane.scrollTop : window.scrollY;
  }

  /** What of the window shows the list, px from its top; free: what nothing lies over. */
  view(free = false) {
    if (!this.isPane) return free ? [BELOW_HEAD, window.innerHeight - ABOVE_FOOT] : [0, window.innerHeight];
    const { top, bottom } = this.pane.getBoundingClientRect();
    return [top + (free ? 4 : 0), bottom - (free ? 4 : 0)];
  }

  to(top) {
    (this.isPane ? this.pane : window).scrollTo({ top, behavior: "instant" });
  }

  by(px) {
    this.to(this.top + px);
  }

  /** Bring the beginning of an element, or a place `px` below it, to the top. */
  toElement(element, px = 0) {
    const [from] = this.view();
    this.by(element.getBoundingClientRect().top + px - from - (this.isPane ? 0 : 116));
  }

  onScroll(action) {
    for (const one of [window, this.pane]) one.addEventListener("scroll", action, { passive: true });
    LARGE.addEventListener("change", action);
  }
}

const KEY = "dousa-library-panes";
const STEP = 24; // px of an arrow key
const LIMITS = { left: [160, 520], right: [300, 1600] };
const FIRST = { left: 240, right: null, look: null, size: 158, list: false };
const WIDE = window.matchMedia("(min-width: 1200px)");

/** hooks: look(open) when the pane of one clip opens or closes, grid({size, list}), map(open) */
export class Panes {
  constructor(hooks) {
    Object.assign(this, { hooks, now: { ...FIRST, ...recall("localStorage", KEY) }, browse: $("#browse"), map: fromAddress("view") === "map" });
    for (const side of ["left", "right"]) this.makeSplitter(side, $(`#split-${side}`));
    this.size = $("#cell-size");
    this.size.value = String(this.now.size);
    this.size.addEventListener("input", () => this.set({ size: Number(this.size.value) }));
    $("#view-grid").addEventListener("click", () => this.showMap(false, { list: false }));
    $("#view-list").addEventListener("click", () => this.showMap(false, { list: true }));
    $("#view-map").addEventListener("click", () => this.showMap(true));
    $("#look-button").addEventListener("click", () => this.set({ look: !this.isOpen }));
    WIDE.addEventListener("change", () => this.draw());
    window.addEventListener("resize", () => this.draw());
    this.draw();
  }

  /** The pane of one clip is open where there is room for it, unless somebody closed it. */
  get isOpen() {
    return WIDE.matches && (this.now.look ?? window.innerWidth >= 1400);
  }

  widthOf(side) {
    const [low, high] = LIMITS[side];
    const room = side === "left" ? 0.4 : 0.62;
    const wanted = this.now[side] ?? Math.round(window.innerWidth * (window.innerWidth > 1900 ? 0.42 : 0.32));
    return Math.min(Math.max(wanted, low), high, Math.max(Math.round(window.innerWidth * room), low));
  }

  set(values) {
    Object.assign(this.now, values);
    keep("localStorage", KEY, this.now);
    this.draw();
  }

  showMap(open, values = {}) {
    this.map = open;
    inAddress({ view: open ? "map" : null });
    this.set(values);
  }

  draw() {
    const { now, browse, map } = this;
    browse.style.setProperty("--left", `${this.widthOf("left")}px`);
    browse.style.setProperty("--right", `${this.widthOf("right")}px`);
    browse.classList.toggle("looking", this.isOpen);
    for (const side of ["left", "right"]) {
      const [low, high] = LIMITS[side];
      for (const [name, value] of [["valuenow", this.widthOf(side)], ["valuemin", low], ["valuemax", high]]) $(`#split-${side}`).setAttribute(`aria-${name}`, String(value));
    }
    $("#view-grid").setAttribute("aria-pressed", String(!map && !now.list));
    $("#view-list").setAttribute("aria-pressed", String(!map && now.list));
    $("#view-map").setAttribute("aria-pressed", String(map));
    $("#look-button").setAttribute("aria-pressed", String(this.isOpen));
    this.size.disabled = now.list || map;
    const shape = `${now.size} ${now.list}`;
    if (shape !== this.shape) this.hooks.grid({ size: now.size, list: now.list });
    this.shape = shape;
    if (map !== this.mapTold) this.hooks.map(map);
    this.mapTold = map;
    if (this.isOpen !== this.told) this.hooks.look(this.isOpen);
    this.told = this.isOpen;
  }

  /** A line between two panes that is dragged, moved with arrow keys, and put back by a double click. */
  makeSplitter(side, line) {
    const sign = side === "left" ? 1 : -1;
    line.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      line.setPointerCapture(event.pointerId);
      const [from, width] = [event.clientX, this.widthOf(side)];
      const move = ({ clientX }) => this.set({ [side]: width + sign * (clientX - from) });
      line.addEventListener("pointermove", move);
      line.addEventListener("lostpointercapture", () => line.removeEventListener("pointermove", move), { once: true });
    });
    line.addEventListener("dblclick", () => this.set({ [side]: FIRST[side] }));
    line.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: -STEP, ArrowRight: STEP }[event.key];
      if (!by) return;
      event.preventDefault();
      this.set({ [side]: this.widthOf(side) + sign * by });
    });
  }
}

export const nothingChosen = () => h("p", { class: "empty" }, t("look_empty"));
