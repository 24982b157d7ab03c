// What came out, how far to trust it, and where to go with it.

import { post } from "../core/api.js";
import { $, formatSeconds, h, icon, t } from "../core/dom.js";
import { finished } from "../core/jobs.js";
import { attempt, notify } from "../core/notices.js";

/** job: a finished estimation with its result. */
export function showOutcome(job) {
  const result = job.result;
  const motion = encodeURIComponent(`job:${job.id}`);
  const trust = result.trust ?? "good"; // of an older studio nothing is known
  const weights = result.warning_weights ?? [];
  const says = result.warnings.map((text, at) => h("li", { class: weights[at] ?? "" }, weights[at] && weights[at] !== "good" ? h("b", { class: "weight" }, t(`weight_${weights[at]}`), " ") : null, text));
  const place = $("#outcome");
  place.replaceChildren(
    h("h2", { id: "outcome-title", class: `trust ${trust}` }, t(`outcome_title_${trust}`)),
    h("p", { class: "note" }, t(`outcome_trust_${trust}`)),
    h("ul", { class: "says" }, ...(says.length ? says : [h("li", { class: "good" }, t("outcome_good"))])),
    h("dl", { class: "outcome-facts" }, ...facts(result).flatMap(([name, value]) => [h("div", {}, h("dt", {}, name), h("dd", {}, value))])),
    h(
      "div",
      { class: "row" },
      h("a", { class: `button ${trust === "bad" ? "" : "primary"}`, id: "search-it", href: `/search?motion=${motion}` }, icon("search"), t("search_it")),
      h("a", { class: "button", id: "evaluate-it", href: `/evaluate?performance=${motion}` }, icon("mark"), t("evaluate_it")),
      h("button", { type: "button", id: "add-it", onclick: () => askAndAdd(job) }, icon("folder"), t("add_it")),
    ),
    h(
      "div",
      { class: "row" },
      ...result.files.map((name) => h("a", { class: "button small quiet", href: `/api/estimations/${job.id}/files/${name}`, download: name }, icon("download"), t(`file_${name}`))),
    ),
  );
  place.hidden = false;
}

function facts(result) {
  const overlap = result.iou.mean === null ? "-" : result.iou.mean.toFixed(2);
  const lost = result.lost_frames.length;
  return [
    [t("outcome_overlap"), overlap],
    [t("outcome_lost"), lost ? t("outcome_of", { count: lost, total: result.n_frames }) : t("outcome_none_lost")],
    [t("outcome_length"), t("outcome_length_value", { frames: result.n_frames, seconds: formatSeconds(result.n_frames / result.frame_rate) })],
    [t("outcome_body"), t("outcome_stature", { value: result.stature_m.toFixed(2) })],
    [t("outcome_speed"), t("outcome_speed_value", { value: result.frames_per_second.toFixed(result.frames_per_second < 10 ? 1 : 0) })],
  ];
}

function askAndAdd(job) {
  const name = h("input", { type: "text", name: "name", required: true, maxlength: "80", value: job.title.replace(/\.[^.]+( \+ \d+)?$/, "") || "estimated" });
  const category = h("input", { type: "text", name: "category", maxlength: "80" });
  const dialog = h(
    "dialog",
    { "aria-label": t("add_title") },
    h(
      "form",
      { method: "dialog" },
      h("h2", {}, t("add_title")),
      h("label", { class: "field" }, t("add_name"), name),
      h("label", { class: "field" }, t("add_category"), category),
      h("div", { class: "foot" }, h("button", { type: "button", onclick: () => dialog.close("cancel") }, t("cancel")), h("button", { class: "primary", value: "add" }, t("add_do"))),
    ),
  );
  dialog.addEventListener("close", () => {
    dialog.remove();
    if (dialog.returnValue === "add") attempt(() => add(job, name.value.trim(), category.value.trim()));
  });
  document.body.append(dialog);
  dialog.showModal();
}

async function add(job, name, category) {
  const asked = await post(`/estimations/${job.id}/add`, { name: name || "estimated", category: category || null });
  const done = await finished(asked.id);
  const report = done.result;
  const taken = report && report.added.length + report.replaced.length + report.unchanged.length + report.duplicates.length > 0;
  if (taken) notify(t("added", { name }));
  else notify(t("add_refused", { reason: done.problem ?? report?.skipped[0]?.reason ?? t(`state_${done.state}`) }), "problem");
}
