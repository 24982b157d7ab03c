// How the files are added: as what, and where their labels come from, with a look at what comes of it.

import { h, t } from "../core/dom.js";

const SHOWN = 5;
const DEEPEST = 6; // levels of folders that are offered
const RULES = { folder: "folder", last_folder: "path:([^/]+)/[^/]+$", none: "none", ...levels(DEEPEST) };

/** {level_2: rule, ...}; the first level is the outermost folder. */
function levels(deepest) {
  return Object.fromEntries(Array.from({ length: deepest }, (_, at) => [`level_${at + 1}`, `path:^(?:[^/]+/){${at}}([^/]+)/`]));
}

/** names: of the motions that came, tables: of labels that lie beside some of them -> {element, value: for POST /jobs/add} */
export function askHow(names, tables = []) {
  const folders = names.some((name) => name.includes("/"));
  const kind = choice("add-kind", ["clip", "take"].map((name) => [name, t(`add_as_${name}`)]), tables.length ? "take" : "clip");
  const depth = Math.min(Math.max(...names.map((name) => name.split("/").length - 1), 0), DEEPEST);
  const byLevel = depth > 1 ? Object.keys(levels(depth)) : [];
  const byFolder = depth > 1 ? ["folder", "last_folder", ...byLevel] : ["folder"];
  const category = rule("category", [...byFolder, "name", "none"], folders ? "folder" : "none", "^([A-Za-z]+)");
  const performer = rule("performer", ["none", ...(depth > 1 ? byLevel : ["level_1"]), "name"], "none", "_([A-Za-z]+[0-9]*)");
  const unit = h("select", { id: "add-unit" }, ...["", "m", "cm", "mm", "inch", "cmu"].map((name) => h("option", { value: name }, t(`unit_${name || "file"}`))));
  const beside = h("input", { type: "checkbox", id: "add-labels", checked: true });
  const labels = h("label", { class: "check" }, beside, t("labels_beside", { count: tables.length }));
  const unread = h("p", { class: "note", id: "labels-unread" }, t("labels_unread"));
  const preview = h("div", { class: "preview" });
  const element = h(
    "div",
    { class: "stack" },
    kind.element,
    labels,
    unread,
    h("div", { class: "option-row" }, category.element, performer.element),
    preview,
    h("details", {}, h("summary", {}, t("options")), h("label", { class: "field narrow" }, t("unit"), unit)),
  );
  const renew = () => {
    category.element.hidden = kind.value === "take";
    labels.hidden = kind.value !== "take" || !tables.length;
    unread.hidden = kind.value === "take" || !tables.length;
    preview.replaceChildren(...look(names, kind.value === "take" ? null : category, performer));
  };
  element.addEventListener("input", renew);
  renew();
  return {
    element,
    get value() {
      const said = { kind: kind.value, performer_from: performer.value, category_from: kind.value === "take" ? "none" : category.value };
      if (!labels.hidden && beside.checked) said.labels = true;
      return unit.value ? { ...said, unit: unit.value } : said;
    },
  };
}

function choice(name, options, chosen) {
  const inputs = options.map(([value]) => h("input", { type: "radio", name, value, id: `${name}-${value}`, checked: value === chosen }));
  const element = h("div", { class: "row", role: "radiogroup", "aria-label": t("add_as") }, ...options.map(([, text], number) => h("label", { class: "check" }, inputs[number], text)));
  return { element, get value() {
    return inputs.find((input) => input.checked).value;
  } };
}

function rule(name, kinds, chosen, pattern) {
  const select = h("select", { id: `add-${name}` }, ...kinds.map((kind) => h("option", { value: kind, selected: kind === chosen }, wordOf(kind))));
  const text = h("input", { type: "text", id: `add-${name}-pattern`, value: pattern, maxlength: "200", spellcheck: "false", "aria-label": t("pattern_of", { name: t(`facet_${name}`) }) });
  const more = h("span", { class: "pattern" }, text, h("span", { class: "note" }, t("pattern_note")));
  const settle = () => (more.hidden = select.value !== "name");
  select.addEventListener("input", settle);
  settle();
  const element = h("label", { class: "field" }, t(`facet_${name}`), select, more);
  return {
    element,
    get value() {
      return select.value === "name" ? `name:${text.value}` : RULES[select.value];
    },
    /** The label of a file as the rule will very likely find it; null for none. */
    guess(file) {
      const at = file.lastIndexOf("/");
      if (select.value === "none") return null;
      if (select.value === "folder") return at < 0 ? null : file.slice(0, at);
      if (select.value !== "name") return new RegExp(RULES[select.value].slice(5), "u").exec(file)?.[1]?.trim() || null;
      const found = new RegExp(text.value, "u").exec(file.slice(at + 1));
      return found?.[1]?.trim() || null;
    },
  };
}

const wordOf = (kind) => (kind.startsWith("level_") && kind !== "level_1" ? t("from_level", { level: kind.slice(6) }) : t(`from_${kind === "level_1" ? "first_folder" : kind}`));

/** What comes out of a rule: how many labels, and which are the most frequent. */
function tally(names, from, word) {
  const counts = new Map();
  try {
    for (const name of names) {
      const label = from.guess(name);
      if (label !== null) counts.set(label, (counts.get(label) ?? 0) + 1);
    }
  } catch {
    return null; // the table says that the expression is not one
  }
  if (!counts.size) return null;
  const most = [...counts].sort((a, b) => b[1] - a[1]).slice(0, 4).map(([label, number]) => t("tally_label", { label, count: number }));
  return h("p", { class: "note tally-line" }, t(word, { count: counts.size, names: most.join(t("tally_comma")) + (counts.size > most.length ? " …" : "") }));
}

function look(names, category, performer) {
  const label = (from, name) => {
    try {
      return from?.guess(name) ?? "–";
    } catch {
      return t("pattern_bad");
    }
  };
  const step = Math.max(Math.floor(names.length / SHOWN), 1);
  const some = names.filter((_, number) => number % step === 0).slice(0, SHOWN);
  const head = ["file", ...(category ? ["facet_category"] : []), "facet_performer"];
  const row = (name) => h("tr", {}, h("td", {}, name), category ? h("td", {}, label(category, name)) : null, h("td", {}, label(performer, name)));
  return [category ? tally(names, category, "tally_category") : null, tally(names, performer, "tally_performer"), h("table", { "aria-label": t("preview") }, h("thead", {}, h("tr", {}, ...head.map((word) => h("th", { scope: "col" }, t(word))))), h("tbody", {}, ...some.map(row)))].filter(Boolean);
}
