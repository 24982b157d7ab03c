// Categories as a tree: kick/right lies below kick. A level stands for all below it, is opened and closed, and counts
// what lies in it; a field above finds levels and categories by parts of their names.

import { cutMiddle } from "../core/cut.js";
import { h, icon, language, t } from "../core/dom.js";

const MOST_ROWS = 400;
const WITH_FIELD = 10; // categories from which there is a field to search in them
const count = new Intl.NumberFormat(language);
const { compare } = new Intl.Collator(language, { numeric: true });
const open = new Map(); // value of a level -> whether it is open, where somebody said so
let wanted = ""; // what is searched for
let field = null;

/** counts: {category: clips}; -> {rows of the tree, or of what is searched for} */
export function categoryTree(counts, filter, redraw) {
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

// --- the levels

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

/** What makes each row: of thousands only those that are shown are made. */
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
