// The evaluation page: choose motions, wait for the grade, look at the report and change what it rests on.

import { Comparison } from "../compare/comparison.js";
import { get, post } from "../core/api.js";
import { $, h, language, t } from "../core/dom.js";
import { followJob, isActive, stopJob } from "../core/jobs.js";
import { attempt, showProblem } from "../core/notices.js";
import { openSharing } from "../core/sharing.js";
import { spellingButton } from "../core/spelling.js";
import { downloadLinks, Result } from "./result.js";
import { keepChoice, readAddress, Setup, showJob } from "./setup.js";

const places = { setup: $("#setup"), progress: $("#progress"), report: $("#report"), compare: $("#compare") };
const result = new Result(places.report);
const setup = new Setup(grade);
const comparison = new Comparison(places.compare);
let following = () => {};

function show(name, problem = "") {
  for (const [other, element] of Object.entries(places)) element.hidden = other !== name;
  $("#lead").hidden = name === "report" || name === "compare";
  if (name !== "compare") comparison.clear();
  showProblem(problem);
  if (name !== "report") $("#tools").hidden = true;
  if (name === "setup") offerComparison();
  if (name === "compare") putTools(h("a", { class: "button", href: "/evaluate" }, t("new_evaluation")));
}

function putTools(...tools) {
  $("#tools").replaceChildren(...tools);
  $("#tools").hidden = false;
}

const comparing = (ids = []) => h("a", { class: "button", id: "compare-open", href: `/evaluate?compare=${ids.join(",")}` }, t("compare_open"));

async function offerComparison() {
  const answer = await get("/comparisons/choices").catch(() => null); // the page is whole without
  if (answer?.evaluations.length > 1 && !places.setup.hidden) putTools(comparing());
}

async function grade(request) {
  const job = await attempt(() => post("/jobs/evaluate", { ...request, language }));
  if (!job) return;
  showJob(job.id);
  follow(job.id);
}

function follow(id) {
  following();
  result.clear();
  show("progress");
  places.progress.replaceChildren();
  let ended = false; // a job may be told twice
  const end = followJob(id, (job) => {
    if (ended) return;
    if (isActive(job)) {
      drawProgress(job);
      return;
    }
    following();
    over(job);
  });
  following = () => {
    ended = true;
    end();
  };
}

function drawProgress(job) {
  const bar = h("progress", { max: String(Math.max(job.total, 1)), value: String(job.done), "aria-label": t("under_way") });
  const what = job.what || t(`state_${job.state}`);
  places.progress.replaceChildren(h("h2", {}, `${t("under_way")}: ${job.title}`), bar, h("div", { class: "row" }, h("p", { class: "note" }, what), h("span", { class: "push" }), h("button", { type: "button", class: "small", onclick: () => attempt(() => stopJob(job.id)) }, t("stop"))));
}

async function over(job) {
  if (job.state !== "done") {
    setup.show(choiceOf(job));
    show("setup", job.state === "failed" ? `${t("failed")}: ${job.problem}` : t("was_stopped"));
    return;
  }
  places.progress.replaceChildren(h("p", {}, t("loading")));
  try {
    // What is drawn needs its place on the page first.
    if (await result.show(job, () => show("report"))) drawTools(job);
  } catch (error) {
    setup.show(choiceOf(job));
    show("setup", error.message);
  }
}

const choiceOf = ({ request }) => ({ performance: request.performance, references: request.references, side: request.side, tempo: request.tempo ?? (request.repetitions ? "free" : "same"), repetitions: Boolean(request.repetitions) });

function drawTools(job) {
  const again = () => {
    result.clear();
    setup.show(choiceOf(job));
    history.pushState(null, "", "/evaluate");
    keepChoice(setup.choice);
    show("setup");
  };
  const files = h("details", { class: "menu" }, h("summary", { class: "button" }, t("download")), h("div", { class: "menu-list" }, ...downloadLinks(job)));
  const print = h("button", { type: "button", id: "print", onclick: () => window.print(), title: t("print_title") }, t("print"));
  const share = h("button", { type: "button", id: "share-report", onclick: () => attempt(() => openSharing(job.id)) }, t("share"));
  const spelled = spellingButton(() => get(`/spelling/evaluations/${job.id}`), "");
  const compare = job.request.repetitions ? [] : [comparing([job.id])];
  putTools(h("button", { type: "button", id: "again", onclick: again }, t("change_motions")), h("a", { class: "button", href: "/evaluate" }, t("new_evaluation")), ...compare, share, spelled, print, files);
}

document.addEventListener("click", (event) => {
  const open = $("#tools .menu[open]");
  if (open && !(open.contains(event.target) && !event.target.closest("a"))) open.open = false;
});

async function open() {
  const asked = readAddress();
  following();
  if (asked.compare !== null) {
    result.clear();
    show("compare");
    await attempt(() => comparison.show(asked.compare));
    return;
  }
  if (!asked.job) {
    result.clear();
    setup.show(asked);
    show("setup");
    return;
  }
  try {
    await get(`/jobs/${asked.job}`);
    follow(asked.job);
  } catch (error) {
    setup.show({ performance: null, references: [] });
    show("setup", error.message);
  }
}

window.addEventListener("popstate", open);
open();
