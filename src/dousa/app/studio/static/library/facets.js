// The facets beside the list: what there is, how many of each, and a way to see only some.

import { cutMiddle } from "../core/cut.js";
import { h, language, t } from "../core/dom.js";
import { nameTag } from "./tags.js";
import { categoryTree } from "./tree.js";

const LENGTHS = { "0-2": [null, 2], "2-5": [2, 5], "5-15": [5, 15], "15-60": [15, 60], "60-": [60, null] };
const count = new Intl.NumberFormat(language);

export function showFacets(form, facets, filter) {
  const focused = form.contains(document.activeElement) ? document.activeElement.dataset.key : null;
  const scrolled = new Map([...form.querySelectorAll(".names")].map((list) => [list.dataset.name, list.scrollTop]));
  form.replaceChildren(
    chips("kind", kinds(facets.kind, filter)),
    chips("length", lengths(facets.length, filter)),
    categories(facets.category, filter, () => showFacets(form, facets, filter)),
    names("performer", facets.performer, filter),
    names("tag", facets.tag, filter),
  );
  for (const list of form.querySelectorAll(".names")) list.scrollTop = scrolled.get(list.dataset.name) ?? 0;
  if (focused !== null) form.querySelector(`[data-key="${CSS.escape(focused)}"]`)?.focus();
}

function group(name, ...inner) {
  return h("fieldset", { hidden: !inner.flat().length }, h("legend", {}, t(`facet_${name}`)), ...inner);
}

// --- one of a few

function kinds(counts, filter) {
  const chosen = filter.get("kind");
  return ["clip", "take"]
    .filter((kind) => counts[kind] || kind === chosen)
    .map((kind) => [kind, t(`${kind}s`), counts[kind] ?? 0, kind === chosen, () => filter.set({ kind: kind === chosen ? null : kind })]);
}

function lengths(counts, filter) {
  return Object.entries(LENGTHS)
    .map(([name, [from, to]]) => {
      const chosen = filter.get("min_s") === (from === null ? "" : String(from)) && filter.get("max_s") === (to === null ? "" : String(to));
      const act = () => filter.set(chosen ? { min_s: null, max_s: null } : { min_s: from === null ? null : String(from), max_s: to === null ? null : String(to) });
      return [name, t(`length_${from ?? 0}`), counts[name] ?? 0, chosen, act];
    })
    .filter(([, , number, chosen]) => number || chosen);
}

function chips(name, options) {
  const buttons = options.map(([key, text, number, chosen, act]) =>
    h("button", { type: "button", class: "small", "aria-pressed": String(chosen), dataset: { key: `${name} ${key}` }, onclick: act }, text, h("span", { class: "n" }, count.format(number))),
  );
  return group(name, buttons.length ? [h("div", { class: "chips" }, ...buttons)] : []);
}

// --- any of many

function categories(counts, filter, redraw) {
  const chosen = filter.query.getAll("category");
  if (new Set([...Object.keys(counts), ...chosen]).size < 2 && !chosen.length) return group("category"); // nothing to choose
  return group("category", categoryTree(counts, filter, redraw));
}

const show = (name, value) => (value ? (name === "tag" ? nameTag(value) : value) : t(name === "tag" ? "no_tag" : "no_label"));

function names(name, counts, filter) {
  const chosen = filter.query.getAll(name);
  const all = new Set([...Object.keys(counts), ...chosen]);
  if (all.size < 2 && !chosen.length) return group(name); // nothing to choose
  const order = [...all].sort((a, b) => (b === "") - (a === "") || a.localeCompare(b, language, { numeric: true }));
  const rows = order.map((value) => {
    const input = h("input", { type: "checkbox", checked: chosen.includes(value), dataset: { key: `${name} ${value}` }, onchange: () => filter.toggle(name, value) });
    return h("label", { class: "name-row" }, input, cutMiddle(h("span", { class: value ? "" : "none", title: value }), show(name, value)), h("span", { class: "n" }, count.format(counts[value] ?? 0)));
  });
  return group(name, [h("div", { class: "names", dataset: { name } }, ...rows)]);
}
