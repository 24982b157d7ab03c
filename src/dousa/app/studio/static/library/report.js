// What became of the files: added, known already, not taken and why.

import { foot } from "../core/dialog.js";
import { h, icon, language, t } from "../core/dom.js";
import { resumeJob } from "../core/jobs.js";
import { attempt } from "../core/notices.js";
import { undo } from "../core/undo.js";

const FEW = 8; // categories that are named in a line
const count = new Intl.NumberFormat(language);

/** -> elements for the dialog; refused: [{name, reason}] of the upload; back() shows the questions again, if there are any */
export function report(job, refused, { close, hooks, back: change }) {
  const done = h("button", { type: "button", class: "primary", onclick: close }, t("close"));
  if (!job.result) {
    const again = job.resumable ? h("button", { type: "button", onclick: () => attempt(() => resumeJob(job.id)) }, t("resume")) : null;
    const differently = change && job.state === "failed" ? h("button", { type: "button", id: "add-back", onclick: change }, t("add_back")) : null;
    return [h("p", { class: "problem-box", role: "alert" }, job.problem ?? t("adding_stopped")), lost(refused, []), foot(...[differently, again, done].filter(Boolean))].filter(Boolean);
  }
  const { result, request } = job;
  const fresh = result.added.length + result.replaced.length;
  const batch = request?.batch;
  const leave = (action) => () => {
    close();
    action(batch);
  };
  const act = (word, action) => h("button", { type: "button", onclick: leave(action) }, t(word));
  const back = fresh && result.change ? [h("button", { type: "button", class: "quiet", id: "undo-adding", onclick: () => (close(), undo(hooks.changed, result.change)) }, icon("undo"), t("undo"))] : [];
  const acts = fresh && batch ? [act("show_added", hooks.showBatch), act("label_added", hooks.relabelBatch), ...back] : [];
  return [
    h("p", { role: "status", id: "add-report", class: "report-head" }, fresh ? icon("mark") : null, t(fresh ? "added_head" : "added_nothing", { count: count.format(fresh), seconds: result.seconds.toFixed(1) })),
    tally(result),
    result.labelled?.length ? h("p", { class: "note", id: "add-labelled" }, t("labelled", { count: count.format(result.labelled.length), segments: count.format(result.n_segments) })) : null,
    lost(refused, result.skipped),
    pairs("duplicates_title", result.duplicates, (item) => [item.path, t("same_as", { name: item.same_as })]),
    pairs("warnings_title", result.warnings, (item) => [item.path, item.warning]),
    pairs("other_labels_title", result.other_labels, (path) => [path, t("labels_stay")]),
    pairs("other_kind_title", result.other_kind, (path) => [path, t("kind_stays")]),
    newCategories(result.new_categories),
    foot(...acts, done),
  ].filter(Boolean);
}

/** A few in a line, many in a list that is opened. */
function newCategories(names) {
  if (!names.length) return null;
  if (names.length <= FEW) return h("p", { class: "note" }, t("new_categories", { names: names.join(t("tally_comma")) }));
  return h("details", { id: "add-categories" }, h("summary", {}, t("new_categories_title", { count: count.format(names.length) })), h("ul", { class: "plain-list scroll" }, ...names.map((name) => h("li", {}, name))));
}

function tally(result) {
  const names = ["added", "replaced", "unchanged", "moved", "duplicates", "skipped"];
  const shown = names.filter((name) => result[name].length);
  return h("dl", { class: "tally" }, ...shown.flatMap((name) => [h("div", {}, h("dt", {}, t(`tally_${name}`)), h("dd", {}, count.format(result[name].length)))]));
}

function lost(refused, skipped) {
  const all = [...refused.map(({ name, reason }) => [name, reason]), ...skipped.map(({ path, reason }) => [path, reason])];
  return table("refused_title", all, "refused");
}

const pairs = (title, items, cells) => table(title, items.map(cells), "");

function table(title, rows, kind) {
  if (!rows.length) return null;
  const lines = rows.map(([name, text]) => h("tr", {}, h("th", { scope: "row" }, name), h("td", {}, text)));
  return h("details", { class: kind, open: kind === "refused" }, h("summary", {}, t(title, { count: count.format(rows.length) })), h("div", { class: "scroll" }, h("table", {}, h("tbody", {}, ...lines))));
}
