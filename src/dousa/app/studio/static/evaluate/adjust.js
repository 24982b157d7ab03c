// The panel in which figures and weights are changed, and what it says of the grade.

import { h, icon, t } from "../core/dom.js";
import { Cuts, isSameFigures } from "./cuts.js";

// What each limb counts: sliders from 0 to 3 for trunk, arms and legs, and for each of the nine segments.
const SEGMENTS = ["trunk", "left_upper_arm", "left_forearm", "right_upper_arm", "right_forearm", "left_thigh", "left_shank", "right_thigh", "right_shank"];
const LIMBS = { trunk: [0], arms: [1, 2, 3, 4], legs: [5, 6, 7, 8] };
const NAMED = { left_arm: [1, 2], right_arm: [3, 4], left_leg: [5, 6], right_leg: [7, 8] };
const MOST_WEIGHT = 3;

/** Weights {segment: number} of all nine, from those of the interface: limbs first, segments count more. */
export function spread(weights = {}) {
  const all = SEGMENTS.map(() => 1);
  for (const [name, members] of Object.entries(NAMED)) if (name in weights) for (const k of members) all[k] = weights[name];
  return SEGMENTS.map((name, k) => weights[name] ?? all[k]);
}

const gather = (values) => Object.fromEntries(SEGMENTS.map((name, k) => [name, values[k]]).filter(([, value]) => value !== 1));

const short = (value) => String(Number(value.toFixed(2)));

/** "Arms 0, left thigh 2": as few words as do. */
function describeWeights(values, names) {
  const said = [];
  for (const [limb, members] of Object.entries(LIMBS)) {
    const inside = members.map((k) => values[k]);
    if (inside.every((value) => value === inside[0])) {
      if (inside[0] !== 1) said.push(`${t(limb)} ${short(inside[0])}`);
    } else for (const k of members) if (values[k] !== 1) said.push(`${names[k]} ${short(values[k])}`);
  }
  return said.join(", ");
}

class Weights {
  constructor(element, { names, onChange }) {
    Object.assign(this, { values: SEGMENTS.map(() => 1), counts: null, onChange, sliders: [] });
    const limbs = Object.entries(LIMBS).map(([limb, members]) => this.makeSlider(t(limb), members, `limb-${limb}`));
    const single = SEGMENTS.map((name, k) => this.makeSlider(names[k], [k], `segment-${name}`));
    const start = () => this.take(SEGMENTS.map(() => 1), true);
    const reset = h("button", { type: "button", class: "small", id: "reset-weights", onclick: start }, t("reset_weights"));
    element.append(
      h("header", { class: "row" }, h("h3", {}, t("weights")), h("span", { class: "push" }), reset),
      h("p", { class: "note" }, t("weights_hint")),
      h("div", { class: "sliders" }, ...limbs),
      h("details", { class: "each" }, h("summary", {}, t("each_segment")), h("div", { class: "sliders" }, ...single)),
    );
    this.draw();
  }

  makeSlider(word, members, name) {
    const [output, counts] = [h("output", {}), h("span", { class: "counts-as", dataset: { counts: name } })];
    const input = h("input", { type: "range", min: "0", max: String(MOST_WEIGHT), step: "0.1", "aria-label": word, dataset: { weight: name } });
    const set = (done) => {
      const value = Number(input.value);
      this.take(this.values.map((one, k) => (members.includes(k) ? value : one)), done);
    };
    input.addEventListener("input", () => set(false));
    input.addEventListener("change", () => set(true));
    this.sliders.push({ input, output, counts, members });
    return h("label", { class: "slider" }, h("span", {}, word), input, output, counts);
  }

  take(values, done) {
    this.values = values;
    this.draw();
    this.onChange(values, done);
  }

  show(values) {
    this.values = [...values];
    this.draw();
  }

  /** What the segments count in the grade, {segment: number}: the weights, of mean 1. */
  showCounts(weights) {
    this.counts = SEGMENTS.map((name) => weights[name]);
    this.draw();
  }

  draw() {
    for (const { input, output, counts, members } of this.sliders) {
      const inside = members.map((k) => this.values[k]);
      const mean = inside.reduce((sum, value) => sum + value, 0) / inside.length;
      const mixed = inside.some((value) => value !== inside[0]);
      if (document.activeElement !== input || mixed) input.value = String(mean);
      output.textContent = mixed ? t("mixed") : short(mean);
      if (this.counts) {
        const shares = members.map((k) => this.counts[k]);
        counts.textContent = t("counts_as", { value: (shares.reduce((sum, one) => sum + one, 0) / shares.length).toFixed(2) });
      }
      input.setAttribute("aria-valuetext", `${output.textContent}, ${counts.textContent}`);
    }
  }
}

// Changes of figures and weights that are taken back and done again, as long as the evaluation is shown.
const MOST = 200;

class Steps {
  /** hooks: read() -> what is shown now, show(what), changed({back, forth}: whether there is a step) */
  constructor(hooks) {
    Object.assign(this, { hooks, kept: [], at: 0, going: false });
    this.press = (event) => {
      const key = event.key.toLowerCase();
      const by = key === "z" ? (event.shiftKey ? 1 : -1) : key === "y" ? 1 : 0;
      if (!by || !(event.ctrlKey || event.metaKey) || event.altKey || event.target.closest?.("input:not([type=range], [type=checkbox]), textarea, select, dialog")) return;
      event.preventDefault();
      this.go(by);
    };
    document.addEventListener("keydown", this.press);
  }

  begin() {
    this.kept = [this.hooks.read()];
  }

  note() {
    if (this.going || !this.kept.length) return;
    const now = this.hooks.read();
    if (JSON.stringify(now) === JSON.stringify(this.kept[this.at])) return;
    this.kept = [...this.kept.slice(0, this.at + 1), now].slice(-MOST);
    this.at = this.kept.length - 1;
    this.tell();
  }

  go(by) {
    const wanted = this.kept[this.at + by];
    if (!wanted) return;
    this.at += by;
    this.going = true;
    this.hooks.show(wanted);
    this.going = false;
    this.tell();
  }

  tell() {
    this.hooks.changed({ back: this.at > 0, forth: this.at < this.kept.length - 1 });
  }

  end() {
    document.removeEventListener("keydown", this.press);
  }
}

/** onChange({weights, furi}, done), onSeek(s of the reference); names: of the nine segments */
export class Adjust {
  constructor(assessment, names, { onChange, onSeek }) {
    Object.assign(this, { found: assessment.furi_found, names, onChange, first: null });
    this.score = h("b", { class: "adjust-score", id: "adjust-score" });
    this.before = h("span", { class: "note" });
    this.state = h("span", { class: "badge", id: "adjust-state" });
    this.changed = h("p", { class: "changed", id: "adjust-changed" });
    this.problem = h("p", { class: "problem-box", role: "alert", hidden: true });
    const [cuts, weights] = [h("section", { class: "cuts", "aria-label": t("cuts") }), h("section", { class: "weights", "aria-label": t("weights") })];
    const says = h("div", { class: "adjust-now", "aria-live": "polite" }, ...this.makeSteps(), h("span", { class: "note" }, t("now")), this.score, this.before, this.state);
    this.element = h("section", { class: "card adjust", id: "adjust", "aria-label": t("adjust") }, h("header", { class: "adjust-head" }, h("div", {}, h("h2", {}, t("adjust")), h("p", { class: "note" }, t("adjust_hint"))), says), this.changed, this.problem, h("div", { class: "adjust-body" }, cuts, weights));
    this.cuts = new Cuts(cuts, {
      duration: assessment.reference_duration_s,
      onSeek,
      onChange: (_, done) => this.tell(done),
      onReset: () => this.cuts.take(this.found.map((one) => ({ ...one })), true),
    });
    this.weights = new Weights(weights, { names, onChange: (_, done) => this.tell(done) });
    this.cuts.show(assessment.furi_used);
    this.weights.show(spread(assessment.weights));
    this.take({ assessment, exact: true, kept: true });
    this.steps.begin();
  }

  makeSteps() {
    const button = (name, by) => h("button", { type: "button", class: "quiet small icon", id: `adjust-${name}`, "aria-label": t(name), title: t(name), disabled: true, onclick: () => this.steps.go(by) }, icon("undo"));
    const buttons = { undo: button("undo", -1), redo: button("redo", 1) };
    this.steps = new Steps({
      read: () => ({ figures: this.cuts.figures.map((one) => ({ ...one })), values: [...this.weights.values] }),
      show: ({ figures, values }) => {
        this.cuts.show(figures);
        this.weights.show(values);
        this.tell(true);
      },
      changed: ({ back, forth }) => {
        buttons.undo.disabled = !back;
        buttons.redo.disabled = !forth;
      },
    });
    return Object.values(buttons);
  }

  values() {
    const { figures } = this.cuts;
    return { weights: gather(this.weights.values), furi: isSameFigures(figures, this.found) ? null : figures };
  }

  tell(done) {
    if (done) this.steps.note();
    this.sayChanged();
    this.setState("working");
    this.onChange(this.values(), done);
  }

  take({ assessment, exact, kept }) {
    this.problem.hidden = true;
    const score = assessment.score;
    this.first ??= score;
    this.score.textContent = score == null ? "–" : score.toFixed(1);
    this.before.textContent = score !== this.first ? t("before_change", { score: this.first?.toFixed(1) ?? "–" }) : "";
    this.setState(exact && kept ? "exact" : exact ? "working" : "approximate");
    this.cuts.showScores(assessment.furi);
    this.weights.showCounts(assessment.segment_weights);
    this.sayChanged();
  }

  setState(name) {
    this.state.textContent = t(name);
    this.state.dataset.state = name;
    this.state.className = `badge ${name === "exact" ? "good" : "unsure"}`;
  }

  refuse(error) {
    this.setState("refused");
    this.problem.textContent = t("not_taken", { reason: error.message });
    this.problem.hidden = false;
  }

  sayChanged() {
    const { figures } = this.cuts;
    const said = [];
    if (!isSameFigures(figures, this.found)) {
      const moved = figures.length !== this.found.length || figures.some((one, k) => Math.abs(one.start_s - this.found[k].start_s) > 0.002);
      said.push(moved ? t("changed_furi", { now: figures.length, found: this.found.length }) : t("changed_labels"));
    }
    const list = describeWeights(this.weights.values, this.names);
    if (list) said.push(t("changed_weights", { list }));
    this.changed.textContent = said.join(" · ") || t("as_found");
    this.changed.classList.toggle("is-changed", said.length > 0);
    this.cuts.reset.disabled = isSameFigures(figures, this.found);
  }

  destroy() {
    this.steps.end();
    this.cuts.destroy();
  }
}
