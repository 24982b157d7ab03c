// The panel in which figures and weights are changed, and what it says of the grade.

import { h, icon, t } from "../core/dom.js";
import { Cuts } from "./cuts.js";
import { isSameFigures } from "./figures.js";
import { Steps } from "./steps.js";
import { Weights, describeWeights, gather, spread } from "./weights.js";

/** onChange({weights, importance, furi}, done), onSeek(s of the reference); names: of the nine segments */
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
    this.weights.show(spread(assessment.weights), assessment.importance);
    this.take({ assessment, exact: true, kept: true });
    this.steps.begin();
  }

  /** Buttons that take a change back, and do it again; the keys do the same. */
  makeSteps() {
    const button = (name, by) => h("button", { type: "button", class: "quiet small icon", id: `adjust-${name}`, "aria-label": t(name), title: t(name), disabled: true, onclick: () => this.steps.go(by) }, icon("undo"));
    const buttons = { undo: button("undo", -1), redo: button("redo", 1) };
    this.steps = new Steps({
      read: () => ({ figures: this.cuts.figures.map((one) => ({ ...one })), values: [...this.weights.values], importance: this.weights.importance }),
      show: ({ figures, values, importance }) => {
        this.cuts.show(figures);
        this.weights.show(values, importance);
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
    return { weights: gather(this.weights.values), importance: this.weights.importance, furi: isSameFigures(figures, this.found) ? null : figures };
  }

  tell(done) {
    if (done) this.steps.note();
    this.sayChanged();
    this.setState("working");
    this.onChange(this.values(), done);
  }

  /** What the studio answered. */
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
    if (this.weights.importance === "equal") said.push(t("equal_importance"));
    this.changed.textContent = said.join(" · ") || t("as_found");
    this.changed.classList.toggle("is-changed", said.length > 0);
    this.cuts.reset.disabled = isSameFigures(figures, this.found);
  }

  destroy() {
    this.steps.end();
    this.cuts.destroy();
  }
}
