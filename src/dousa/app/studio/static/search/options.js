// How is searched: a folded form that writes into the state.

import { h, t } from "../core/dom.js";

const RANKINGS = ["fused", "pose", "leaves", "histogram"];

export function drawOptions(form, state, onChange) {
  const select = h("select", { name: "ranking", onchange: () => onChange({ ranking: select.value === "fused" ? null : select.value }) }, ...RANKINGS.map((name) => h("option", { value: name }, t(`ranking_${name}`))));
  select.value = state.ranking ?? "fused";
  const count = h("select", { name: "k", onchange: () => onChange({ k: Number(count.value) === 12 ? null : Number(count.value) }) }, ...[6, 12, 24, 40, 100].map((n) => h("option", { value: String(n) }, String(n))));
  if (state.k && ![6, 12, 24, 40, 100].includes(state.k)) count.append(h("option", { value: String(state.k) }, String(state.k)));
  count.value = String(state.k ?? 12);
  const check = (name) => {
    const box = h("input", { type: "checkbox", name, onchange: () => onChange({ [name]: box.checked }) });
    box.checked = state[name];
    return h("label", { class: "check" }, box, t(name));
  };
  const shown = h("output", {}, "");
  const slider = h("input", { type: "range", name: "threshold", min: "0", max: "1", step: "0.05" });
  const learned = h("button", { type: "button", class: "small", onclick: () => onChange({ threshold: null }) }, t("threshold_learned"));
  slider.value = String(state.threshold ?? 0.5);
  const say = () => (shown.textContent = state.threshold === null ? t("threshold_learned") : `${Math.round(100 * Number(slider.value))} %`);
  slider.addEventListener("input", () => (shown.textContent = `${Math.round(100 * Number(slider.value))} %`));
  slider.addEventListener("change", () => onChange({ threshold: Number(slider.value) }));
  say();
  const field = (name, ...inside) => h("label", { class: "field" }, t(name), ...inside);
  form.replaceChildren(field("ranking", select), field("k", count), check("same_category"), check("mirror"), h("div", { class: "row threshold" }, field("threshold", slider), shown, state.threshold === null ? null : learned));
}
