// Evaluations beside each other (?compare=JOB,JOB): one pupil on several dates, or several pupils of one figure.

import { get } from "../core/api.js";
import { breakable } from "../core/cut.js";
import { h, language, t, wholeGrade } from "../core/dom.js";
import { attempt } from "../core/notices.js";

// What a comparison says, as a table: a row for the grade, each figure, each kind of error, each part of the body.
const LEAST_POINTS = 1; // of a grade, that count

/** Rows {title} or {name, values: [number or null], texts, up: whether more is better} of the answer of /comparisons. */
function listRows({ attempts, kinds, segments }) {
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
function makeTable(heads, rows, mode) {
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

function best(values, value, up) {
  const known = values.filter((one) => one !== null);
  const [low, high] = [Math.min(...known), Math.max(...known)];
  if (value === null || known.length < 2 || high - low < LEAST_POINTS) return "";
  return value === (up ? high : low) ? "best" : "";
}

const repeated = (ids) => ids.map((id) => `job=${id}`).join("&");
const dateOf = (one) => new Date(1000 * one.created_s).toLocaleString(language, { month: "short", day: "numeric", hour: "2-digit", minute: "2-digit" });

export class Comparison {
  constructor(root) {
    Object.assign(this, { root, chosen: [], player: null, turn: null });
  }

  clear() {
    this.turn = null;
    this.player?.destroy();
    this.player = null;
    this.root.replaceChildren();
  }

  async show(ids) {
    this.clear();
    const mine = (this.turn = Symbol("comparison"));
    const { evaluations } = await get("/comparisons/choices");
    if (mine !== this.turn) return;
    this.all = evaluations;
    const asked = evaluations.filter((one) => ids.includes(one.id));
    const model = asked[0]?.model ?? this.largest();
    // Whoever comes from one report sees all that can be held beside it.
    const wanted = asked.length > 1 ? asked : evaluations.filter((one) => one.model === model);
    this.chosen = wanted.filter((one) => one.model === model).map((one) => one.id);
    this.mode = new Set(this.shown().map((one) => one.name)).size === this.chosen.length && this.chosen.length > 1 ? "pupils" : "dates";
    this.list = h("div", { class: "compare-list" });
    this.place = h("div", { class: "compare-result stack" });
    this.root.replaceChildren(h("section", { class: "card stack", "aria-labelledby": "compare-title" }, h("h2", { id: "compare-title" }, t("compare_title")), h("p", { class: "note" }, t(evaluations.length > 1 ? "compare_hint" : "compare_none")), this.list), this.place);
    this.drawList();
    await this.compare();
  }

  largest() {
    const count = new Map();
    for (const { model } of this.all) count.set(model, (count.get(model) ?? 0) + 1);
    return [...count].sort((a, b) => b[1] - a[1])[0]?.[0];
  }

  shown() {
    return this.all.filter((one) => this.chosen.includes(one.id)).sort((a, b) => a.created_s - b.created_s);
  }

  drawList() {
    const models = [...new Set(this.all.map((one) => one.model))];
    const name = ({ references: [first, ...more] }) => (more.length ? t("compare_more", { name: first, count: more.length }) : first);
    const group = (model) => {
      const own = this.all.filter((one) => one.model === model);
      return h("fieldset", { class: "compare-group" }, h("legend", {}, breakable(t("compare_group", { names: name(own[0]) }))), ...own.map((one) => this.row(one)));
    };
    this.list.replaceChildren(...models.map(group));
  }

  row(one) {
    const box = h("input", { type: "checkbox", checked: this.chosen.includes(one.id), dataset: { job: one.id }, onchange: () => this.choose(one, box.checked) });
    const grade = one.score === null ? t("compare_no_grade") : t("compare_grade_of", { score: wholeGrade(one.score) });
    return h("label", { class: "check compare-row" }, box, h("span", { class: "compare-name" }, breakable(one.name)), h("span", { class: "compare-grade" }, grade), h("span", { class: "note compare-date" }, dateOf(one)));
  }

  /** Those against another reference cannot stay: what is chosen is always of one. */
  choose(one, wanted) {
    const others = this.shown().filter((other) => other.model === one.model && other.id !== one.id);
    this.chosen = [...others.map((other) => other.id), ...(wanted ? [one.id] : [])];
    for (const box of this.list.querySelectorAll("input")) box.checked = this.chosen.includes(box.dataset.job);
    attempt(() => this.compare());
  }

  async compare() {
    const mine = (this.turn = Symbol("comparison"));
    const jobs = this.shown();
    history.replaceState(null, "", `/evaluate?compare=${jobs.map((one) => one.id).join(",")}`);
    this.player?.destroy();
    this.player = null;
    if (jobs.length < 2) {
      this.place.replaceChildren();
      return;
    }
    const found = await get(`/comparisons?${repeated(jobs.map((one) => one.id))}&language=${language}`);
    if (mine !== this.turn) return;
    this.found = found;
    this.draw(jobs, mine);
  }

  draw(jobs, mine) {
    const mode = (value) => {
      const input = h("input", { type: "radio", name: "compare-mode", value, checked: this.mode === value, onchange: () => ((this.mode = value), this.fill(jobs)) });
      return h("label", { class: "check" }, input, t(`compare_${value}`));
    };
    this.says = h("p", { class: "compare-says", role: "status" });
    this.table = h("div", { class: "compare-scroll", tabindex: "0", role: "region", "aria-label": t("compare_table") });
    this.picture = h("img", { class: "compare-picture", alt: t("compare_picture") });
    const figure = h("div", { class: "compare-player" });
    const choice = (word, at) => h("label", { class: "field" }, t(word), h("select", { onchange: () => this.showTwo(figure, selects, mine) }, ...jobs.map((one, place) => h("option", { value: one.id, selected: place === at }, `${one.name}, ${dateOf(one)}`))));
    const fields = [choice("compare_left", 0), choice("compare_right", jobs.length - 1)];
    const selects = fields.map((field) => field.querySelector("select"));
    this.place.replaceChildren(
      h("section", { class: "card stack" }, h("fieldset", { class: "row compare-mode" }, h("legend", { class: "sr" }, t("compare_as")), mode("dates"), mode("pupils")), this.says, this.table),
      h("section", { class: "card stack", "aria-labelledby": "compare-two" }, h("h2", { id: "compare-two" }, t("compare_two")), h("div", { class: "row compare-choice" }, ...fields), figure),
      this.picture,
    );
    this.fill(jobs);
    this.showTwo(figure, selects, mine);
  }

  fill(jobs) {
    const { found, mode } = this;
    const common = found.still_says.length ? t("compare_still_pupils", { list: found.still_says.join(t("compare_list")) }) : t("compare_no_common");
    this.says.textContent = mode === "dates" ? found.says : common;
    const heads = jobs.map((one) => [h("a", { href: `/evaluate?job=${one.id}` }, breakable(one.name)), h("span", { class: "note" }, dateOf(one))]);
    this.table.replaceChildren(makeTable(heads, listRows(found), mode));
    this.picture.hidden = mode !== "dates";
    if (mode === "dates") this.picture.src = `/api/comparisons/progress.svg?${repeated(jobs.map((one) => one.id))}&language=${language}`;
  }

  async showTwo(place, selects, mine) {
    const [left, right] = selects.map((select) => select.value);
    if (left === right) return;
    const data = await attempt(() => get(`/comparisons/player?${repeated([left, right])}&language=${language}`));
    if (mine !== this.turn || !data) return;
    if (this.player) this.player.replace(data);
    else this.player = window.dousa.createPlayer(place, data);
  }
}
