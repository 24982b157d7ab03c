// The facets beside the list: what there is, how many of each, and a way to see only some.

import { cutMiddle } from "../core/cut.js";
import { count, h, icon, language, t } from "../core/dom.js";
import { nameTag } from "./tags.js";

// Categories as a tree: kick/right lies below kick. A level stands for all below it, is opened and closed, and counts
// what lies in it; a field above finds levels and categories by parts of their names.
const MOST_ROWS = 400;
const WITH_FIELD = 10; // categories from which there is a field to search in them
const { compare } = new Intl.Collator(language, { numeric: true });
const open = new Map(); // value of a level -> whether it is open, where somebody said so
let wanted = ""; // what is searched for
let field = null;

/** counts: {category: clips}; -> {rows of the tree, or of what is searched for} */
function categoryTree(counts, filter, redraw) {
  const chosen = filter.query.getAll("category");
  const root = grow([...new Set([...Object.keys(counts), ...chosen.map((one) => one.replace(/\/$/, ""))])], counts);
  const tell = (node) => toggle(filter, chosen, node);
  const rows = wanted ? search(root, chosen, tell) : walk(root, chosen, tell, redraw);
  const more = rows.length - MOST_ROWS;
  const list = h("div", { class: "names tree-rows", dataset: { name: "category" } }, ...rows.slice(0, MOST_ROWS).map((make) => make()));
  if (more > 0) list.append(h("p", { class: "note" }, t("tree_more", { count: count.format(more) })));
  if (wanted && !rows.length) list.append(h("p", { class: "note" }, t("tree_none")));
  return [...(Object.keys(counts).length > WITH_FIELD || wanted ? [searchField(redraw)] : []), list];
}

function searchField(redraw) {
  field ??= h("input", { type: "search", id: "tree-field", class: "tree-field", maxlength: "100", "aria-label": t("tree_search"), placeholder: t("tree_search"), autocomplete: "off", spellcheck: "false", dataset: { key: "category search" } });
  field.oninput = () => {
    wanted = field.value.trim();
    redraw();
  };
  return field;
}

/** A node: {name, value ("" for none; with a slash for a level), own, total, below: Map} */
function grow(names, counts) {
  const root = { value: "", total: 0, below: new Map() };
  for (const name of names) {
    const number = counts[name] ?? 0;
    let at = root;
    const parts = name === "" ? [""] : name.split("/");
    for (const [depth, part] of parts.entries()) {
      if (!at.below.has(part)) at.below.set(part, { name: part, path: parts.slice(0, depth + 1).join("/"), own: null, total: 0, below: new Map() });
      at = at.below.get(part);
      at.total += number;
    }
    at.own = number;
  }
  return root;
}

const valueOf = (node) => (node.below.size ? `${node.path}/` : node.path);
const inOrder = (nodes) => [...nodes].sort((a, b) => (b.path === "") - (a.path === "") || compare(a.name, b.name));
const isBelow = (value, level) => level.endsWith("/") && value !== level && `${value}/`.startsWith(level);

function walk(node, chosen, tell, redraw, depth = 0) {
  const rows = [];
  const levels = depth > 0 || [...node.below.values()].some((other) => other.below.size);
  for (const one of inOrder(node.below.values())) {
    const value = valueOf(one);
    const isOpen = one.below.size > 0 && (open.get(value) ?? (node.below.size === 1 || chosen.some((other) => isBelow(other, value))));
    const flip = one.below.size ? () => (open.set(value, !isOpen), redraw()) : null;
    rows.push(() => row(one, chosen, tell, { depth, isOpen, flip, text: one.name, levels }));
    if (!isOpen) continue;
    // Clips of the level itself, of none of those below it.
    if (one.own !== null && !chosen.includes(value)) rows.push(() => row({ ...one, below: new Map(), total: one.own }, chosen, tell, { depth: depth + 1, text: t("tree_itself", { name: one.name }), levels: true }));
    rows.push(...walk(one, chosen, tell, redraw, depth + 1));
  }
  return rows;
}

const folded = (text) => text.normalize("NFKC").toLowerCase();

function search(root, chosen, tell) {
  const words = folded(wanted).split(/\s+/);
  const found = [];
  const look = (node) => {
    for (const one of inOrder(node.below.values())) {
      if (one.path && words.every((word) => folded(one.path).includes(word))) found.push(() => row(one, chosen, tell, { depth: 0, text: valueOf(one) }));
      look(one);
    }
  };
  look(root);
  return found;
}

function row(node, chosen, tell, { depth, isOpen, flip, text, levels }) {
  const value = valueOf(node);
  const above = chosen.some((other) => isBelow(value, other));
  const input = h("input", { type: "checkbox", checked: above || chosen.includes(value), dataset: { key: `category ${value}` }, onchange: () => tell(node) });
  input.indeterminate = !input.checked && chosen.some((other) => isBelow(other, value));
  const shown = node.path === "" ? t("no_label") : text;
  const arrow = flip ? h("button", { type: "button", class: `quiet tree-arrow${isOpen ? " tree-open" : ""}`, "aria-expanded": String(isOpen), "aria-label": t(isOpen ? "tree_close" : "tree_open", { name: node.path }), dataset: { key: `level ${value}` }, onclick: flip }, icon("next")) : levels ? h("span", { class: "tree-arrow" }) : null;
  const label = h("label", { class: "name-row" }, input, cutMiddle(h("span", { class: node.path ? "" : "none", title: node.path || shown }), shown), h("span", { class: "n" }, count.format(node.total)));
  return levels ? h("div", { class: "tree-row", style: { paddingLeft: `${14 * depth}px` } }, arrow, label) : label;
}

/** Choose a level or a category, or let it go; of what lies above and below it nothing else stays. */
function toggle(filter, chosen, node) {
  const value = valueOf(node);
  const others = chosen.filter((other) => other !== value && !isBelow(value, other) && !isBelow(other, value));
  filter.setAll("category", chosen.includes(value) ? others : [...others, value]);
}

// What the list is filtered by; it stands in the address, so that a reload or a link shows the same.
const SINGLE = ["text", "wide", "kind", "min_s", "max_s", "batch", "saved", "sort"];
const SEVERAL = ["category", "performer", "tag"];

export class Filter {
  constructor(changed) {
    this.changed = changed;
    const asked = new URLSearchParams(location.search);
    this.query = new URLSearchParams();
    for (const name of SINGLE) if (asked.get(name)) this.query.set(name, asked.get(name));
    for (const name of SEVERAL) for (const value of asked.getAll(name)) this.query.append(name, value);
  }

  get(name) {
    return this.query.get(name) ?? "";
  }

  get narrows() {
    return [...this.query.keys()].some((name) => name !== "sort" && name !== "wide");
  }

  set(values) {
    for (const [name, value] of Object.entries(values)) {
      if (value === null || value === "") this.query.delete(name);
      else this.query.set(name, value);
    }
    this.tell();
  }

  toggle(name, value) {
    const others = this.query.getAll(name);
    this.setAll(name, others.includes(value) ? others.filter((other) => other !== value) : [...others, value]);
  }

  setAll(name, values) {
    this.query.delete(name);
    for (const value of values) this.query.append(name, value);
    this.tell();
  }

  replace(values) {
    const sort = this.get("sort");
    this.query = new URLSearchParams(sort ? { sort } : {});
    for (const [name, value] of Object.entries(values)) for (const one of [value].flat()) if (one !== null) this.query.append(name, String(one));
    this.tell();
  }

  tell() {
    const address = new URL(location.href);
    for (const name of [...SINGLE, ...SEVERAL]) address.searchParams.delete(name);
    for (const [name, value] of this.query) address.searchParams.append(name, value);
    history.replaceState(null, "", address);
    this.changed();
  }
}

const LENGTHS = { "0-2": [null, 2], "2-5": [2, 5], "5-15": [5, 15], "15-60": [15, 60], "60-": [60, null] };

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
