// What each limb counts: sliders from 0 to 3 for trunk, arms and legs, and for each of the nine segments.

import { h, t } from "../core/dom.js";

export const SEGMENTS = ["trunk", "left_upper_arm", "left_forearm", "right_upper_arm", "right_forearm", "left_thigh", "left_shank", "right_thigh", "right_shank"];
const LIMBS = { trunk: [0], arms: [1, 2, 3, 4], legs: [5, 6, 7, 8] };
const NAMED = { left_arm: [1, 2], right_arm: [3, 4], left_leg: [5, 6], right_leg: [7, 8] };
const MOST = 3;

/** Weights {segment: number} of all nine, from those of the interface: limbs first, segments count more. */
export function spread(weights = {}) {
  const all = SEGMENTS.map(() => 1);
  for (const [name, members] of Object.entries(NAMED)) if (name in weights) for (const k of members) all[k] = weights[name];
  return SEGMENTS.map((name, k) => weights[name] ?? all[k]);
}

/** What is sent: segments that do not weigh 1. */
export const gather = (values) => Object.fromEntries(SEGMENTS.map((name, k) => [name, values[k]]).filter(([, value]) => value !== 1));

const short = (value) => String(Number(value.toFixed(2)));

/** "Arms 0, left thigh 2": as few words as do. */
export function describeWeights(values, names) {
  const said = [];
  for (const [limb, members] of Object.entries(LIMBS)) {
    const inside = members.map((k) => values[k]);
    if (inside.every((value) => value === inside[0])) {
      if (inside[0] !== 1) said.push(`${t(limb)} ${short(inside[0])}`);
    } else for (const k of members) if (values[k] !== 1) said.push(`${names[k]} ${short(values[k])}`);
  }
  return said.join(", ");
}

/** onChange(values of the nine segments, done) */
export class Weights {
  constructor(element, { names, onChange }) {
    Object.assign(this, { values: SEGMENTS.map(() => 1), counts: null, onChange, sliders: [] });
    this.learned = h("input", { type: "checkbox", id: "learned-importance", checked: "" });
    this.learned.addEventListener("change", () => this.onChange(this.values, true));
    const limbs = Object.entries(LIMBS).map(([limb, members]) => this.makeSlider(t(limb), members, `limb-${limb}`));
    const single = SEGMENTS.map((name, k) => this.makeSlider(names[k], [k], `segment-${name}`));
    const start = () => {
      this.learned.checked = true;
      this.take(SEGMENTS.map(() => 1), true);
    };
    const reset = h("button", { type: "button", class: "small", id: "reset-weights", onclick: start }, t("reset_weights"));
    element.append(
      h("header", { class: "row" }, h("h3", {}, t("weights")), h("span", { class: "push" }), reset),
      h("p", { class: "note" }, t("weights_hint")),
      h("label", { class: "choice" }, this.learned, h("span", {}, t("learned_importance"))),
      h("div", { class: "sliders" }, ...limbs),
      h("details", { class: "each" }, h("summary", {}, t("each_segment")), h("div", { class: "sliders" }, ...single)),
    );
    this.draw();
  }

  makeSlider(word, members, name) {
    const [output, counts] = [h("output", {}), h("span", { class: "counts-as", dataset: { counts: name } })];
    const input = h("input", { type: "range", min: "0", max: String(MOST), step: "0.1", "aria-label": word, dataset: { weight: name } });
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

  /** Show other weights; nobody is told. */
  show(values, importance) {
    this.values = [...values];
    this.learned.checked = importance !== "equal";
    this.draw();
  }

  get importance() {
    return this.learned.checked ? "learned" : "equal";
  }

  /** What the segments count in the grade, {segment: number}: the weights times what matters in the reference. */
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
