// What is searched for and how, as it stands in the address: reload and back show the same again.

import { h, t } from "../core/dom.js";

// How is searched: a folded form that writes into the state.
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

const NUMBERS = ["start_s", "end_s", "k", "threshold", "other_start_s", "other_end_s"];
const TEXTS = ["motion", "hit", "ranking", "unit", "up", "text", "from"];
const SWITCHES = ["mirror", "same_category"];

export function readState() {
  const asked = new URLSearchParams(location.search);
  const state = {};
  for (const name of TEXTS) state[name] = asked.get(name) || null;
  for (const name of NUMBERS) {
    const value = asked.get(name);
    state[name] = value === null || value === "" || !Number.isFinite(Number(value)) ? null : Number(value);
  }
  for (const name of SWITCHES) state[name] = asked.get(name) === "1";
  return state;
}

function addressOf(state) {
  const asked = new URLSearchParams();
  for (const [name, value] of Object.entries(state)) {
    if (value === null || value === false || value === undefined) continue;
    asked.set(name, value === true ? "1" : typeof value === "number" ? String(Number(value.toFixed(3))) : value);
  }
  return `/search?${asked}`;
}

export function keepState(state, { replace = false } = {}) {
  const address = addressOf(state);
  if (address === location.pathname + location.search) return;
  if (replace) history.replaceState(null, "", address);
  else history.pushState(null, "", address);
}

export function isSameSearch(a, b) {
  return ["motion", "start_s", "end_s", "unit", "up", "ranking", "k", "same_category", "mirror", "threshold"].every((name) => a[name] === b[name]);
}

export const isSameMotion = (a, b) => ["motion", "unit", "up"].every((name) => a[name] === b[name]);

export const wholeOf = ({ motion, unit, up }) => ({ motion, unit, up });

export function queryOf({ motion, start_s, end_s, unit, up }) {
  const query = { motion };
  for (const [name, value] of Object.entries({ start_s, end_s, unit, up })) if (value !== null) query[name] = value;
  return query;
}

export function askOf(state) {
  const asked = { query: queryOf(state), k: state.k ?? 12, mirror: state.mirror || null, same_category: state.same_category };
  if (state.ranking) asked.ranking = state.ranking;
  if (state.threshold !== null) asked.threshold = state.threshold;
  return asked;
}
