// What a comparison says, as a table: a row for the grade, each figure, each kind of error, each part of the body.

import { h, t, wholeGrade } from "../core/dom.js";

const LEAST_POINTS = 1; // of a grade, that count

/** Rows {title} or {name, values: [number or null], texts, up: whether more is better} of the answer of /comparisons. */
export function listRows({ attempts, kinds, segments }) {
  const grade = (score) => (score === null ? "-" : wholeGrade(score));
  const row = (name, pick, say, up) => ({ name, values: attempts.map(pick), texts: attempts.map((one) => say(pick(one), one)), up });
  const rows = [row(t("compare_grade"), (one) => one.score, grade, true)];
  const figures = attempts[0].figures.length > 1 && attempts.every((one) => one.figures.length === attempts[0].figures.length);
  if (figures) rows.push({ title: t("compare_figures") }, ...attempts[0].figures.map(({ label }, at) => row(t("compare_figure", { number: at + 1, label }), (one) => one.figures[at].score, grade, true)));
  const unit = { global: "s", partial: "°", incomplete: "°", shift: "ms" };
  const size = (count, one, kind) => (one.sizes[kind] === null ? String(count) : `${count} (${one.sizes[kind]} ${unit[kind]})`);
  rows.push({ title: t("compare_kinds") }, ...Object.entries(kinds).map(([kind, name]) => row(name, (one) => one.errors[kind], (count, one) => size(count, one, kind), false)));
  rows.push(row(t("compare_lapses"), (one) => one.lapses, String, false));
  rows.push({ title: t("compare_segments") }, ...Object.entries(segments).map(([key, name]) => row(name, (one) => one.segments[key] ?? null, (count) => (count === null ? "-" : String(count)), false)));
  return rows;
}

/** heads: what stands in the head of each column; mode: "dates" (against the first column) or "pupils" (the best is marked) */
export function makeTable(heads, rows, mode) {
  const head = h("tr", {}, h("th", { scope: "col" }, t("compare_what")), ...heads.map((one) => h("th", { scope: "col" }, one)));
  return h("table", { class: "compare-table" }, h("thead", {}, head), h("tbody", {}, ...rows.map((row) => (row.title ? titleRow(row.title, heads.length) : valueRow(row, mode)))));
}

const titleRow = (title, columns) => h("tr", { class: "compare-title" }, h("th", { scope: "colgroup", colspan: String(columns + 1) }, title));

function valueRow({ name, values, texts, up }, mode) {
  const cells = values.map((value, at) => {
    const judged = mode === "dates" ? change(values[0], value, at, up) : best(values, value, up);
    return h("td", { class: judged ? `compare-${judged}` : "" }, texts[at], judged ? mark(judged, up) : null);
  });
  return h("tr", {}, h("th", { scope: "row" }, name), ...cells);
}

function mark(judged, up) {
  const sign = judged === "best" ? "★" : (judged === "better") === up ? "▲" : "▼";
  return h("span", { class: "compare-mark", title: t(`compare_${judged}`) }, h("span", { "aria-hidden": "true" }, ` ${sign}`), h("span", { class: "sr" }, ` ${t(`compare_${judged}`)}`));
}

function change(first, value, at, up) {
  if (!at || first === null || value === null) return "";
  const by = up ? value - first : first - value;
  if (Math.abs(by) < LEAST_POINTS) return "";
  return by > 0 ? "better" : "worse";
}

/** The best of the row, where they differ. */
function best(values, value, up) {
  const known = values.filter((one) => one !== null);
  const [low, high] = [Math.min(...known), Math.max(...known)];
  if (value === null || known.length < 2 || high - low < LEAST_POINTS) return "";
  return value === (up ? high : low) ? "best" : "";
}
