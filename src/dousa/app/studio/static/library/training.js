// The forest: what state it is in, training it, and what came of it.

import { get, post } from "../core/api.js";
import { foot, openDialog } from "../core/dialog.js";
import { $, count, h, language, t } from "../core/dom.js";
import { followJob, isActive } from "../core/jobs.js";
import { attempt } from "../core/notices.js";
import { inAddress } from "./places.js";
import { waiting } from "./waiting.js";

const percent = new Intl.NumberFormat(language, { style: "percent", maximumFractionDigits: 0 });

export async function readForest() {
  return (await get("/info")).library;
}

function stateOf(library) {
  if (!library.trained_at) return ["unsure", t("forest_none")];
  if (!library.forest_is_current) return ["unsure", t("forest_old")];
  return ["good", t("forest_current")];
}

export function showForest(library) {
  const [kind, text] = stateOf(library);
  const badge = h("span", { class: `badge ${kind}`, title: t("forest_what") }, text);
  $("#forest-state").replaceChildren(badge);
  const stale = !library.forest_is_current && Object.keys(library.categories).length > 1;
  $("#train-button").classList.toggle("primary", Boolean(stale && library.n_clips));
  $("#add-button").classList.toggle("primary", !(stale && library.n_clips));
}

function explain(library) {
  const lines = [library.trained_at ? t("trained_on", { count: count.format(library.n_trained), when: new Date(library.trained_at).toLocaleString(language) }) : t("forest_none_long")];
  if (library.n_learned) lines.push(t("learned_since", { count: count.format(library.n_learned) }));
  if (library.trained_at && !library.forest_is_current) lines.push(t("forest_old_long", { count: count.format(library.n_clips - library.n_unlabelled) }));
  const enough = Object.keys(library.categories).length > 1;
  if (!enough) lines.push(t("too_few_categories"));
  return [h("p", {}, lines.join(" ")), enough];
}

/** The dialog: with a job it shows how far it is, and its result. changed() when a training is over. */
export async function openTraining(jobId, changed) {
  const body = h("div", { class: "stack" });
  let end = () => {};
  const { close } = openDialog(t("train_title"), body, {
    onClose: () => {
      end();
      inAddress({ job: null });
    },
  });
  const follow = (id) => {
    inAddress({ job: id });
    end();
    end = followJob(id, (job) => {
      showJob(body, job, { close, again: ask });
      if (!isActive(job)) changed();
    });
  };
  const ask = async () => {
    const library = await attempt(readForest);
    if (library) body.replaceChildren(...question(library, close, follow));
    $("#train-go")?.focus();
  };
  if (jobId) follow(jobId);
  else await ask();
}

function question(library, close, follow) {
  const [text, enough] = explain(library);
  const now = library.parameters ?? {};
  const features = h("select", { id: "train-features" }, ...["extended", "paper"].map((name) => h("option", { value: name, selected: name === (now.feature_set ?? "extended") }, t(`features_${name}`))));
  const trees = h("input", { type: "number", id: "train-trees", min: "1", max: "2000", step: "1", value: String(now.n_trees ?? 100), required: true });
  const go = h("button", { type: "submit", class: "primary", id: "train-go", disabled: !enough }, t("train"));
  const form = h(
    "form",
    { class: "stack" },
    text,
    h("details", {}, h("summary", {}, t("options")), h("div", { class: "option-row" }, h("label", { class: "field" }, t("features"), features), h("label", { class: "field" }, t("trees"), trees)), h("p", { class: "note" }, t("features_note"))),
    foot(h("button", { type: "button", onclick: close }, t("cancel")), go),
  );
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    go.disabled = true;
    attempt(async () => follow((await post("/jobs/train", { feature_set: features.value, n_trees: Number(trees.value) })).id)).finally(() => (go.disabled = false));
  });
  return [form];
}

function showJob(body, job, { close, again }) {
  if (isActive(job)) {
    body.replaceChildren(...waiting(job, t(job.state === "queued" ? "waits" : "training_now"), close, h("p", { class: "note" }, t("train_close_note"))));
    return;
  }
  const buttons = foot(h("button", { type: "button", onclick: again }, t("train_again")), h("button", { type: "button", class: "primary", onclick: close }, t("close")));
  if (job.state === "done") body.replaceChildren(...result(job.result), buttons);
  else body.replaceChildren(h("p", { class: "problem-box" }, job.problem ?? t("training_stopped")), buttons);
}

function result(report) {
  const names = Object.entries(report.categories).sort(([, a], [, b]) => b - a);
  return [
    h("p", { role: "status", id: "train-result" }, t("trained_result", { clips: count.format(report.n_clips), categories: count.format(names.length), trees: count.format(report.n_trees), seconds: report.seconds.toFixed(1) })),
    h("p", {}, calibrationWords(report.calibration)),
    report.n_unlabelled ? h("p", { class: "note" }, t("unlabelled_note", { count: count.format(report.n_unlabelled) })) : null,
    report.single.length ? h("p", { class: "note" }, t("single_note", { names: report.single.join(", ") })) : null,
    report.doubt ? h("p", { class: "note" }, report.doubt) : null,
    h("details", {}, h("summary", {}, t("clips_by_category")), h("div", { class: "scroll bars" }, ...names.map(([name, number]) => bar(name, number, names[0][1])))),
  ].filter(Boolean);
}

function bar(name, number, most) {
  return h("div", { class: "bar-row" }, h("span", {}, name), h("span", { class: "track" }, h("i", { style: { width: `${(100 * number) / most}%` } })), h("span", { class: "value" }, count.format(number)));
}

function calibrationWords(calibration) {
  if (!calibration) return t("no_calibration");
  return t("calibration", { misses: percent.format(calibration.misses), alarms: percent.format(calibration.false_alarms) });
}
