// The page of takes: the labels of a long recording over its figure; corrections are learned. Labels that lie beside a
// take, in a table, are dropped with it or onto it, and shown in the place of those that are recognised.

import { get, post, remove, uploadAll } from "../core/api.js";
import { $, baseName, formatSeconds, h, icon, language, t } from "../core/dom.js";
import { dropZone, fileInput, LABEL_FILES, MOTION_FILES, offerChange, showUntrained } from "../core/drop.js";
import { finished, followJob, isActive, stopJob } from "../core/jobs.js";
import { attempt, notify, showProblem } from "../core/notices.js";
import { pickClips } from "../core/pick.js";
import { spellingButton } from "../core/spelling.js";
import { Timeline } from "../core/timeline.js";
import { drawStrip, makeLegend, nameOf, sayShares, Tones, toSegment } from "../core/timeline_parts.js";
import { listenForUndo, undoButton } from "../core/undo.js";
import { Desk, drawSegments, markSegments, Review } from "./desk.js";

// The takes of the library, each with its labels in a strip.
function say(labels, duration) {
  if (!labels?.segments) return t("not_labelled");
  return t(labels.given ? "strip_given" : "strip_facts", { count: labels.segments.length, unknown: sayShares(labels.segments, duration) });
}

/** A list of rows that lead to their takes; the strips come when they are known. */
function listTakes(items) {
  const tones = new Tones(); // one for all: a category has one colour in the whole list
  const rows = items.map((clip) => {
    const strip = h("div", { class: "take-strip", "aria-hidden": "true" });
    const facts = h("span", { class: "note" });
    const top = h("span", { class: "take-top" }, h("b", {}, baseName(clip.path)), facts, h("span", { class: "note" }, clip.performer ?? ""), h("span", { class: "note" }, formatSeconds(clip.duration)));
    return { clip, strip, facts, element: h("li", {}, h("a", { class: "take-row", href: `/takes?motion=clip:${clip.id}` }, top, strip)) };
  });
  const asked = new URLSearchParams(items.map((clip) => ["motion", `clip:${clip.id}`]));
  if (items.length)
    get(`/takes/strips?${asked}`).then(({ takes }) => {
      for (const { clip, strip, facts } of rows) {
        const labels = takes[`clip:${clip.id}`];
        facts.textContent = say(labels, clip.duration);
        drawStrip(strip, (labels?.segments ?? []).map(toSegment), clip.duration, tones);
      }
    }, (error) => notify(error.message, "problem"));
  return h("ul", { class: "take-list" }, ...rows.map((row) => row.element));
}

const TOUCH = 0.1; // s
const TABLE = /\.(eaf|textgrid|csv|tsv|txt)$/i; // that labels may be in

const TITLE = document.title;

let library = null;
let motion = null; // the take that is shown
let info = null;
let player = null;
let timeline = null;
let labels = []; // stretches with corrections, or those that were given
let recognised = null; // stretches that the library found, also where given ones are shown; null before it was asked
let wantsGiven = true; // shows the given labels where there are some
let jobShown = null;
let loads = 0; // how often the labels were asked for

const review = new Review({
  segments: () => labels,
  time: () => player?.time ?? 0,
  onGo: (segment) => {
    player.pause();
    seek(segment.start_s);
    choose(segment);
  },
  onChoose: (segment) => choose(segment),
  onLearn: (part) => learn({ of: part.category, ...part }), // a stretch keeps its name; what else happens at that time stays
  isShown: () => !$("#take").hidden,
});

const desk = new Desk($("#now"), {
  onCorrect: (part, category) => learn({ ...part, category }),
  onUndo: (id) => takeBack(id),
  onStretch: (segment) => choose(segment),
  onExport: (part) => exportPart(part.start, part.end),
}, review.element);

async function show(name, at) {
  motion = name;
  showFrame(true);
  let facts, data;
  try {
    [facts, data] = await Promise.all([get("/motions/info", { motion: name }), get("/motions/player", { motion: name, language })]);
  } catch (error) {
    if (motion === name) await drawStart(error.message);
    return;
  }
  if (motion !== name) return;
  info = facts;
  makeTimeline();
  if (player) player.replace(data);
  else makePlayer(data);
  $("#take-name").textContent = info.name;
  document.title = `${info.name} - ${t("page_takes")} - dousa`;
  drawTools(null);
  seek(at ?? 0);
  timeline.showPart(at ?? 0);
  const known = await load();
  if (motion === name && (!known.labels || !known.is_current)) label();
}

function showFrame(shown, problem = "") {
  $("#start").hidden = shown;
  $("#take").hidden = $("#change").hidden = !shown;
  showProblem(problem);
}

function makeTimeline() {
  timeline?.destroy();
  labels = [];
  recognised = null;
  const onSeek = (seconds) => {
    player.pause();
    player.seek(seconds);
  };
  timeline = new Timeline($("#timeline"), { duration: info.duration_s, selectable: true, label: t("labels"), onSeek, onSelect: (part) => desk.setPart(part), onSpace: () => player.toggle() });
  desk.setPart(null);
}

function makePlayer(data) {
  player = window.dousa.createPlayer($("#player"), data);
  player.onTime((seconds) => {
    timeline.setCursor(seconds);
    const now = labels.filter((one) => one.start_s <= seconds && seconds < one.end_s);
    markSegments($("#segments"), now.map((one) => labels.indexOf(one)));
    desk.setNow(now, timeline.tones);
    review.settle();
  });
}

function seek(seconds) {
  player.seek(seconds);
  timeline.setCursor(seconds);
}

function choose(segment) {
  timeline.setSelection(segment.start_s, segment.end_s, segment.category);
  desk.setPart({ start: segment.start_s, end: segment.end_s, of: segment.category }, nameOf(segment));
}

async function exportPart(start, end) {
  const { openDownload } = await import("../core/exporting.js");
  openDownload({ motion, start_s: start.toFixed(3), end_s: end.toFixed(3) }, `${t("export_part")}: ${formatSeconds(start)} – ${formatSeconds(end)}`);
}

/** Given stretches that have a name, as the timeline and the table take them. */
const named = (segments) => segments.filter((one) => one.category).map((one) => ({ ...one, unknown: false, perhaps: false, confidence: null, corrected: null }));

async function load() {
  const [name, turn] = [motion, ++loads];
  const answer = await get("/takes/labels", { motion: name });
  if (name !== motion || turn !== loads) return answer; // a later one knows more
  const given = wantsGiven ? answer.given : null;
  drawTools(answer.given);
  recognised = answer.labels?.segments ?? null;
  labels = given ? named(given.segments) : (answer.labels?.segments ?? []);
  const shown = labels.length ? labels : answer.corrections.map((one) => ({ ...one, corrected: one.id, confidence: 1 }));
  const segments = shown.map(toSegment);
  timeline.setSegments(segments);
  $("#legend").replaceChildren(makeLegend(segments, timeline.tones));
  drawSegments($("#segments"), labels, { motion, tones: timeline.tones, onGo: (one) => seek(one.start_s), onChoose: (one) => { seek(one.start_s); choose(one); }, onExport: (one) => exportPart(one.start_s, one.end_s) });
  desk.setCorrections(answer.corrections);
  const facts = { duration: formatSeconds(info.duration_s), count: labels.length, unknown: sayShares(labels, info.duration_s) };
  const said = given ? t("facts_given", { ...facts, source: given.source }) : t("facts", facts);
  $("#take-facts").textContent = labels.length ? said : formatSeconds(info.duration_s);
  player.seek(player.time); // tells what is now
  return answer;
}

async function label() {
  const name = motion;
  const job = await attempt(() => post("/jobs/label", { take: { motion: name } }));
  return job && watch(job.id, name);
}

async function labelAgain() {
  const name = motion;
  const state = await label();
  if (state !== "done" || name !== motion || $("#show-given")?.getAttribute("aria-pressed") !== "true") return;
  await showGiven(false);
  notify(t("labelled_again"), "note", h("button", { type: "button", class: "small", onclick: () => name === motion && showGiven(true) }, t("show_given")));
}

async function showGiven(wants) {
  wantsGiven = wants;
  await attempt(load);
}

async function watch(id, name) {
  jobShown = id;
  const end = followJob(id, (job) => jobShown === id && drawProgress(job));
  const job = await finished(id);
  end();
  if (jobShown === id) $("#progress").replaceChildren();
  if (job.state === "failed") notify(job.problem, "problem");
  if (name === motion && job.state === "done") await attempt(load);
  return job.state;
}

function drawProgress(job) {
  if (!isActive(job)) return;
  const bar = h("progress", { max: String(Math.max(job.total, 1)), value: job.total > 1 && job.done > 0 ? String(job.done) : null, "aria-label": t("labelling") }); // a bar that is empty for a minute says nothing
  const stop = h("button", { type: "button", class: "small", onclick: () => attempt(() => stopJob(job.id)) }, t("stop"));
  $("#progress").replaceChildren(h("div", { class: "progress-row" }, h("span", { class: "note" }, job.total > 1 ? t("learning_step", { step: Math.min(job.done + 1, job.total), total: job.total }) : t("labelling")), bar, stop));
}

const placesOf = (category) => (recognised ?? []).filter((one) => one.category === category && !one.corrected);

/** To a stretch that the library found, which given labels hide. */
async function showFound(segment) {
  if (wantsGiven && $("#show-given")) await showGiven(false);
  player.pause();
  seek(segment.start_s);
  choose(segment);
  $(".tl-cursor").focus();
}

/** split: makes two parts; replaces: numbers of the corrections that go; of: what was meant, of several labels at one time. All
 * of it is undone in one step. */
async function learn({ start, end, category, split = null, replaces = [], of = null }) {
  const [name, before] = [motion, recognised && placesOf(category)];
  const learned = await attempt(() => post("/takes/correct", { motion, start_s: start, end_s: end, category, split_s: split, replaces, instead_of: of }));
  if (!learned) return false;
  library.categories[category] = (library.categories[category] ?? 0) + learned.corrections.length;
  desk.setCategories(Object.keys(library.categories));
  timeline.setSelection(null);
  desk.setPart(null);
  await attempt(load);
  await label();
  const touches = ({ start_s, end_s }) => start_s < end + TOUCH && start - TOUCH < end_s; // an edge of the part itself
  const isNew = (place) => !touches(place) && !before.some((one) => one.start_s < place.end_s && place.start_s < one.end_s);
  const more = before && name === motion ? placesOf(category).filter(isNew) : [];
  const lead = more.length ? h("button", { type: "button", class: "small", dataset: { act: "show" }, onclick: () => name === motion && attempt(() => showFound(more[0])) }, t("show")) : null;
  notify(t(more.length ? "learned_more" : "learned_here", { category, count: more.length }), "note", h("div", { class: "notice-acts" }, lead, undoButton(learned.change, afterUndo)));
  return true;
}

async function takeBack(id) {
  const answer = await attempt(() => remove(`/takes/corrections/${id}`));
  if (!answer) return;
  notify(t("undone"), "note", undoButton(answer.change, afterUndo));
  await attempt(load);
  await label();
}

async function afterUndo() {
  if (!motion) return;
  await load();
  await label();
}

listenForUndo(afterUndo);

function drawTools(given) {
  const shows = Boolean(given) && wantsGiven;
  const download = (kind) => h("a", { class: "button small", href: `/api/takes/export?${new URLSearchParams({ motion, format: kind, given: shows })}`, download: "", title: t("export_title", { kind: t(`export_${kind}`) }), id: `export-${kind}` }, icon("download"), t(`export_${kind}`));
  const button = (id, name, word, action, pressed = null) => h("button", { type: "button", class: "small", id, "aria-pressed": pressed, onclick: action }, ...(name ? [icon(name)] : []), t(word));
  const add = motion.startsWith("file:") ? button("add-take", "folder", "add_take", () => attempt(() => addTake(motion).then((found) => found && open(found, null, player.time)))) : null;
  const which = given ? button("show-given", "tag", "show_given", () => showGiven(!wantsGiven), String(shows)) : null;
  const spelled = given ? null : spellingButton(() => post("/spelling/label", { take: { motion } }));
  const input = fileInput(take, { accept: LABEL_FILES, id: "labels-file" });
  const give = button("give-labels", "upload", "give_labels", () => input.click());
  $("#take-tools").replaceChildren(...[which, input, give, add, button("label-again", null, "label_again", () => labelAgain()), ...["csv", "eaf", "json"].map(download), spelled].filter(Boolean));
}

async function addTake(from) {
  const [batch, name] = [from.slice(5, 21), from.slice(22)];
  const job = await finished((await post("/jobs/add", { batch, kind: "take", category_from: null })).id);
  if (job.state !== "done") throw new Error(job.problem ?? t(`state_${job.state}`));
  const refused = job.result.skipped?.find((item) => item.path.endsWith(name));
  if (refused) throw new Error(refused.reason);
  const { items } = await get("/clips", { kind: "take", text: baseName(name), limit: 20 });
  const found = items.find((item) => item.path.endsWith(`${batch}/${name}`)) ?? items[0];
  notify(t("add_take_done", { name: baseName(name) }));
  return found?.motion ?? null;
}

/** Give a take the labels of an uploaded table; one that was dropped goes into the library for that. */
async function annotate(onto, batch, table) {
  const name = onto.startsWith("file:") ? await addTake(onto) : onto;
  const answer = await post("/takes/annotate", { motion: name, batch, name: table });
  for (const note of answer.notes) notify(note);
  notify(t("labels_given", { count: answer.n_segments, name: baseName(table) }));
  wantsGiven = true;
  for (const one of answer.given?.segments ?? []) if (one.category) library.categories[one.category] ??= 1;
  desk.setCategories(Object.keys(library.categories));
  if (name === motion) await load();
  else open(name);
}

function open(name, job = null, at = null) {
  const asked = new URLSearchParams({ motion: name });
  if (at) asked.set("at_s", at.toFixed(2));
  history.pushState(null, "", `/takes?${asked}`);
  attempt(() => show(name, at));
}

async function take(entries) {
  const came = await attempt(() => uploadAll(entries));
  if (!came) return;
  for (const { name, reason } of came.refused) notify(`${name}: ${reason}`, "problem");
  const recording = came.files.find((file) => file.motion)?.motion;
  const table = came.files.find((file) => !file.motion && TABLE.test(file.name));
  const onto = recording ?? motion;
  if (table && onto) await attempt(() => annotate(onto, came.batch, table.name));
  else if (recording) open(recording);
  else if (!came.refused.length) notify(t(table ? "labels_need_take" : "no_motion_file"), "problem");
}

async function pick() {
  const [clip] = await pickClips({ kind: "take", title: t("pick_take") });
  if (clip) open(clip.motion ?? `clip:${clip.id}`);
}

/** Where a take is chosen; problem: why one that was asked for is not shown. */
async function drawStart(problem = "") {
  motion = jobShown = null;
  player?.pause();
  document.title = TITLE;
  $("#progress").replaceChildren();
  showFrame(false, problem);
  const { items } = await get("/clips", { kind: "take", limit: 100 });
  const list = items.length ? listTakes(items) : h("p", { class: "note" }, t("start_no_takes"));
  const zone = dropZone(take, { text: t("start_drop"), hint: t("start_hint"), accept: MOTION_FILES, id: "take-file" });
  $("#start").replaceChildren(h("div", { class: "choose" }, zone, h("h2", {}, t("start_takes")), list));
}

async function followAddress() {
  const asked = new URLSearchParams(location.search);
  let name = asked.get("motion");
  try {
    if (asked.get("job")) name = (await get(`/jobs/${encodeURIComponent(asked.get("job"))}`)).request.take.motion;
  } catch (error) {
    await drawStart(error.message);
    return;
  }
  const at = Number(asked.get("at_s"));
  if (name) await show(name, Number.isFinite(at) ? at : 0);
  else await drawStart();
}

async function start() {
  library = (await get("/info")).library;
  if (!library.trained_at) return showUntrained();
  desk.setCategories(Object.keys(library.categories));
  offerChange(take, pick);
  window.addEventListener("popstate", () => attempt(followAddress));
  await followAddress();
}

attempt(start);
