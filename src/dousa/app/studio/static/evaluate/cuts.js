// The figures of the reference: a timeline whose cuts can be dragged, and a table of the same for the keyboard.

import { h, icon, t } from "../core/dom.js";
import { Timeline } from "../core/timeline.js";

// Figures of the dance as a list that can be changed: {start_s, end_s, label} in order, side by side.
export const LEAST = 0.1; // s

const round = (seconds) => Math.round(seconds * 1000) / 1000;

const cutsOf = (figures) => figures.slice(1).map((one) => one.start_s);

export const isSameFigures = (a, b) =>
  a.length === b.length && a.every((one, k) => Math.abs(one.start_s - b[k].start_s) < 0.002 && Math.abs(one.end_s - b[k].end_s) < 0.002 && one.label === b[k].label);

/** A label that no figure has: A, B, ... Z, AA, AB, ... */
function freshLabel(figures) {
  const taken = new Set(figures.map((one) => one.label));
  const name = (number) => (number < 26 ? "" : name(Math.floor(number / 26) - 1)) + String.fromCharCode(65 + (number % 26));
  for (let number = 0; ; number++) if (!taken.has(name(number))) return name(number);
}

/** The figures with other cuts: moved ones keep their labels, a new one begins a figure with a label of its own. */
function recut(figures, cuts) {
  const before = cutsOf(figures);
  const edges = [figures[0].start_s, ...cuts, figures.at(-1).end_s].map(round);
  let labels = figures.map((one) => one.label);
  if (cuts.length > before.length) {
    const at = cuts.findIndex((cut, k) => before[k] === undefined || Math.abs(cut - before[k]) > 1e-6);
    labels = [...labels.slice(0, at + 1), freshLabel(figures), ...labels.slice(at + 1)];
  } else if (cuts.length < before.length) {
    const at = before.findIndex((cut, k) => cuts[k] === undefined || Math.abs(cut - cuts[k]) > 1e-6);
    labels = labels.filter((_, k) => k !== at + 1);
  }
  return labels.map((label, k) => ({ start_s: edges[k], end_s: edges[k + 1], label }));
}

export class Cuts {
  constructor(element, { duration, onChange, onSeek, onReset }) {
    Object.assign(this, { duration, onChange, onSeek, figures: [] });
    const place = h("div", { id: "cuts-timeline" });
    this.rows = h("tbody");
    const head = ["figure", "name", "from", "to", "figure_grade"].map((name) => h("th", { scope: "col" }, t(name)));
    const table = h("table", { class: "cuts-table" }, h("thead", {}, h("tr", {}, ...head, h("td", {}))), this.rows);
    this.reset = h("button", { type: "button", class: "small", id: "reset-cuts", onclick: onReset }, t("reset_cuts"));
    element.append(h("header", { class: "row" }, h("h3", {}, t("cuts")), h("span", { class: "push" }), this.reset), place, h("p", { class: "note" }, t("cuts_hint")), h("div", { class: "scroll cuts-scroll", tabindex: "0" }, table));
    const onCuts = (cuts, done) => this.take(recut(this.figures, cuts), done, false);
    this.timeline = new Timeline(place, { duration, editable: true, label: t("cuts_timeline"), onSeek, onCuts });
  }

  take(figures, done, fresh = true) {
    this.figures = figures;
    this.draw(fresh);
    this.onChange(figures, done);
  }

  show(figures) {
    this.figures = figures.map((one) => ({ ...one }));
    this.draw(true);
  }

  draw(fresh) {
    const segments = this.figures.map(({ start_s, end_s, label }) => ({ start: start_s, end: end_s, label, kind: "known" }));
    this.timeline.setSegments(segments);
    if (fresh) this.timeline.setCuts(cutsOf(this.figures));
    while (this.rows.children.length > this.figures.length) this.rows.lastChild.remove();
    while (this.rows.children.length < this.figures.length) this.rows.append(this.makeRow(this.rows.children.length));
    this.figures.forEach((figure, place) => this.fillRow(this.rows.children[place], figure));
  }

  makeRow(place) {
    const number = place + 1;
    const name = h("input", { type: "text", class: "figure-name", maxlength: "100", "aria-label": t("name_of", { number }) });
    name.addEventListener("input", () => {
      const label = name.value.trim();
      if (label) this.change(place, { label }, false);
    });
    name.addEventListener("change", () => this.change(place, { label: name.value.trim() || this.figures[place].label }, true));
    const start = h("input", { type: "number", class: "figure-start", step: "0.1", min: "0", disabled: place === 0, "aria-label": t("start_of", { number }) });
    start.addEventListener("change", () => this.moveStart(place, Number(start.value)));
    const join = place ? h("button", { type: "button", class: "quiet small icon", title: t("join", { number }), "aria-label": t("join", { number }), onclick: () => this.join(place) }, icon("close")) : null;
    const go = h("button", { type: "button", class: "quiet small", "aria-label": t("go_to", { number }), onclick: () => this.onSeek(this.figures[place].start_s + 0.01) }, String(number));
    return h("tr", {}, h("td", {}, go), h("td", {}, name), h("td", {}, start), h("td", { class: "to" }), h("td", { class: "figure-score" }), h("td", {}, join));
  }

  fillRow(row, { start_s, end_s, label }) {
    const [name, start] = [row.querySelector(".figure-name"), row.querySelector(".figure-start")];
    if (document.activeElement !== name) name.value = label;
    if (document.activeElement !== start || Number(start.value) !== start_s) start.value = start_s.toFixed(2);
    row.querySelector(".to").textContent = end_s.toFixed(2);
  }

  change(place, values, done) {
    this.take(this.figures.map((one, other) => (other === place ? { ...one, ...values } : one)), done);
  }

  moveStart(place, seconds) {
    const cuts = cutsOf(this.figures);
    const [low, high] = [this.figures[place - 1].start_s + LEAST, this.figures[place].end_s - LEAST];
    if (Number.isFinite(seconds)) cuts[place - 1] = Math.min(Math.max(seconds, low), high);
    this.take(recut(this.figures, cuts), true);
  }

  join(place) {
    const cuts = cutsOf(this.figures).filter((_, other) => other !== place - 1);
    this.take(recut(this.figures, cuts), true);
    this.rows.children[Math.min(place, this.rows.children.length) - 1]?.querySelector("input").focus();
  }

  /** The grade of each figure, with the decimal that it comes with: rounded once more it may not be what the report says. */
  showScores(furi) {
    [...this.rows.children].forEach((row, place) => {
      const score = furi[place]?.score;
      row.querySelector(".figure-score").textContent = score == null ? "–" : score.toFixed(1);
    });
  }

  setCursor(seconds) {
    this.timeline.setCursor(seconds);
  }

  destroy() {
    this.timeline.destroy();
  }
}
