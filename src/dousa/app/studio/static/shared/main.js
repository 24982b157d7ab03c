// What others on the network see: a list of reports and the clips of the library, or one report; or an inbox, the one
// place that takes anything.

import { drawFigure, get, postBytes } from "../core/api.js";
import { openDialog } from "../core/dialog.js";
import { $, formatSeconds, h, language, later, t } from "../core/dom.js";
import { attempt, showProblem } from "../core/notices.js";
import { foldAnalysis, putParts } from "../evaluate/parts.js";

// One report to look at: advice, player and worst moments first; the analysis is folded.
async function drawReport(root, id, repetitions) {
  const answer = await get(`/reports/${id}${repetitions ? "/exercise" : ""}`, { language });
  root.hidden = false; // what is drawn needs its place on the page first
  root.innerHTML = repetitions ? answer.markup : answer.frame;
  if (!repetitions) {
    putParts(root, answer.parts);
    sayNotes($("[data-part='notes']", root), answer.notes);
    foldAnalysis(root);
  }
  $("[data-part='files']", root)?.replaceChildren();
  const bind = repetitions ? window.dousa.bindExercise : window.dousa.bindReport;
  bind(root, answer.data, window.dousa.createPlayer($("#player", root), answer.player));
}

function sayNotes(section, notes) {
  if (!notes.trim()) section.remove();
  else section.replaceChildren(h("h2", {}, t("notes")), h("div", { class: "card" }, h("p", { class: "notes-said" }, notes)));
}

// The clips of the library, some at a time; a press on one plays it.
const AT_ONCE = 24;
const calm = window.matchMedia("(prefers-reduced-motion: reduce)");
let [text, shown, turn] = ["", 0, 0];
let figures = [];

function clipRow({ id, name, category, duration }) {
  const canvas = h("canvas", { class: "figure-small", "aria-hidden": "true" });
  const motion = `clip:${id}`;
  const about = h("span", { class: "note" }, [category || t("no_label"), formatSeconds(duration)].join(" · "));
  const row = h("li", {}, h("button", { type: "button", class: "shared-clip", onclick: () => attempt(() => play(motion, name)) }, canvas, h("span", { class: "shared-text" }, h("b", {}, name), about)));
  drawFigure(canvas, { motion }).then((figure) => figure && figures.push(figure));
  return row;
}

async function play(motion, name) {
  const data = await get("/motions/player", { motion, language });
  const place = h("div", {});
  let player = null;
  openDialog(name, place, { wide: true, onClose: () => player?.destroy() });
  player = window.dousa.createPlayer(place, data);
  player.loop(0, player.duration);
  if (!calm.matches) player.play();
}

async function addMore(fresh) {
  const mine = fresh ? ++turn : turn;
  const offset = fresh ? 0 : shown;
  const { total, items } = await get("/clips", { text, offset, limit: AT_ONCE });
  if (mine !== turn) return;
  if (fresh) {
    figures.forEach((one) => one.destroy());
    figures = [];
    $("#shared-clips").replaceChildren();
  }
  shown = offset + items.length;
  $("#shared-clips").append(...items.map(clipRow));
  $("#shared-count").textContent = t("clip_count", { count: total });
  $("#shared-more").hidden = shown >= total;
}

function showLibrary() {
  $("#shared-library").hidden = false;
  $("#shared-more").addEventListener("click", () => attempt(() => addMore(false)));
  $("#shared-text").addEventListener("input", later(() => {
    text = $("#shared-text").value;
    attempt(() => addMore(true));
  }, 200));
  attempt(() => addMore(true));
}

const when = new Intl.DateTimeFormat(language, { dateStyle: "medium", timeStyle: "short" });

function reportRow({ id, name, created_s: created, repetitions }) {
  const about = [when.format(new Date(1000 * created)), repetitions ? t("exercise") : ""].filter(Boolean).join(" · ");
  return h("li", {}, h("a", { class: "card shared-report", href: `/report?job=${id}` }, h("b", {}, name || t("unnamed")), h("span", { class: "note" }, about)));
}

async function showList() {
  const { reports, everything, page } = await get("/reports");
  if (page !== "/") {
    location.replace(page);
    return;
  }
  $("#shared-reports").replaceChildren(...(reports.length ? reports.map(reportRow) : [h("li", { class: "note" }, t("no_reports"))]));
  $("#shared-list").hidden = false;
  if (everything) showLibrary();
}

async function showReport(id) {
  const { reports, everything } = await get("/reports");
  const asked = reports.find((one) => one.id === id);
  $("#home").href = everything ? "/" : location.pathname + location.search;
  const name = asked?.name || t("unnamed");
  $("#title").textContent = name;
  $("#title").className = "sr"; // the report has a title of its own
  document.title = `${name} - dousa`;
  const file = asked?.repetitions ? "exercise" : "report";
  const links = [h("a", { class: "button small", id: "download", href: `/api/reports/${id}/${file}.html?language=${language}`, download: "" }, t("download_report"))];
  if (everything) links.unshift(h("a", { class: "button small", href: "/" }, t("all_shared")));
  $("#tools").replaceChildren(...links);
  $("#tools").hidden = false;
  await drawReport($("#report"), id, Boolean(asked?.repetitions));
}

// A phone films by itself where a field of files asks for a new film: no camera on this page, no certificate to trust for it.
async function showInbox() {
  const answer = await get("/inbox");
  const pick = (id, word, kind, options) => h("label", { class: `button ${kind}`, for: id }, t(word), h("input", { type: "file", class: "sr", id, onchange: (event) => send(event.target), ...options }));
  $("#film-choose").replaceChildren(
    pick("film", "film_now", "primary", { accept: "video/*", capture: "environment" }),
    pick("files", "film_choose", "", { accept: ["video/*", ...answer.kinds].join(","), multiple: true }),
  );
  $("#film-limits").textContent = t("film_limits", { files: answer.most_files, most: answer.most_bytes / 1e9 });
  $("#title").textContent = t("film_title");
  $(".badge").hidden = true;
  $("#shared-inbox").hidden = false;
  sayFiles(answer.files);
}

function sayFiles(files) {
  const rows = files.map(({ name, bytes }) => h("li", { class: "card" }, h("b", {}, name), " ", h("span", { class: "note" }, `${Math.max(bytes / 1e6, 0.1).toFixed(1)} MB`)));
  $("#film-files").replaceChildren(...(rows.length ? rows : [h("li", { class: "note" }, t("film_none"))]));
}

async function send(field) {
  const files = [...field.files];
  field.value = ""; // the same one can be sent again after a failure
  for (const file of files) {
    $("#film-now").textContent = t("film_sending", { name: file.name });
    const answer = await attempt(() => postBytes("/inbox", file, { name: file.name }));
    $("#film-now").textContent = answer ? t("film_sent", { name: file.name }) : "";
    if (answer) sayFiles(answer.files);
  }
}

const asked = new URLSearchParams(location.search).get("job");
try {
  if (location.pathname === "/film") await showInbox();
  else await (location.pathname === "/report" && asked ? showReport(asked) : showList());
} catch (error) {
  showProblem(error.message);
}
