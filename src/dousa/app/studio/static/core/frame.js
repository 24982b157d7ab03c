// What every page has: language, light and dark, the tray of jobs.

import "./look.js";
import "./sharing.js";
import { get, post } from "./api.js";
import { $, formatSeconds, h, t } from "./dom.js";
import { forgetJob, isActive, resumeJob, stopJob, watchJobs } from "./jobs.js";
import { attempt, notify } from "./notices.js";
import { listenForPalette } from "./palette.js";

// How long a job takes, and word of its end for who looks at something else meanwhile.
const SOON = 3; // s before which nothing can be foretold

/** "12.0 s, about 1:30 to go"; after its end how long it took. */
function sayTimes(job, now = Date.now() / 1000) {
  if (!job.started_s) return "";
  const spent = Math.max((job.finished_s ?? now) - job.started_s, 0);
  if (!isActive(job)) return job.finished_s ? t("job_took", { time: formatSeconds(spent) }) : "";
  const left = spent >= SOON && job.done > 0 && job.total > job.done ? (spent / job.done) * (job.total - job.done) : null;
  return left === null ? formatSeconds(spent) : t("job_left", { time: formatSeconds(spent), left: formatSeconds(left) });
}

const KEY = "dousa_tell";
const able = () => "Notification" in window;
const wanted = () => able() && Notification.permission === "granted" && localStorage.getItem(KEY) === "yes";

/** A switch: word of the end of jobs while another page is looked at. Nothing where the browser has no such thing. */
function tellSwitch() {
  if (!able()) return null;
  const button = h("button", { type: "button", class: "small", id: "jobs-tell", "aria-pressed": String(wanted()), title: t("jobs_tell_title") }, t("jobs_tell"));
  button.addEventListener("click", async () => {
    const wants = !wanted();
    if (wants && Notification.permission !== "granted") await Notification.requestPermission();
    localStorage.setItem(KEY, wants ? "yes" : "no");
    button.setAttribute("aria-pressed", String(wanted()));
  });
  return button;
}

const before = new Map(); // job id -> whether it was under way

function tellEnds(jobs) {
  for (const job of jobs) {
    const ended = before.get(job.id) && !isActive(job);
    before.set(job.id, isActive(job));
    if (!ended || !document.hidden || !wanted()) continue;
    const title = t("job_title", { kind: t(`kind_${job.kind}`), title: job.title });
    const note = new Notification(title, { body: job.problem ?? t(`state_${job.state}`), tag: job.id });
    note.addEventListener("click", () => window.focus());
  }
}

// On a phone the tabs are wider than the window: the one that is open is brought into it.
const tab = $(".bar nav [aria-current]");
if (tab) {
  const [box, nav] = [tab.getBoundingClientRect(), tab.parentElement.getBoundingClientRect()];
  if (box.right > nav.right) tab.parentElement.scrollLeft += box.right - nav.right;
}

const tray = $("#jobs-tray");
const trayButton = $("#jobs-button");
const space = h("div", { class: "space" });
const PLACES = { evaluate: "evaluate", estimate: "estimate", masks: "estimate", label: "takes", add: "library", watch: "library", train: "library", demo: "library", review: "library", map: "library" };

const placeOf = ({ kind, id }) => (kind === "masks" ? `/estimate?masks=${id}` : `/${PLACES[kind]}?job=${id}`);

function toggleTray(open) {
  tray.hidden = !open;
  trayButton.setAttribute("aria-expanded", String(open));
  if (open) {
    tray.focus({ preventScroll: true });
    showSpace();
  }
}

trayButton.addEventListener("click", () => toggleTray(tray.hidden));
document.addEventListener("keydown", (event) => {
  if (event.key !== "Escape") return;
  const menu = $("details.menu[open]");
  if (!tray.hidden) {
    toggleTray(false);
    trayButton.focus();
  } else if (menu) {
    menu.open = false;
    $("summary", menu).focus();
  }
});
document.addEventListener("pointerdown", (event) => {
  if (!tray.hidden && !tray.contains(event.target) && !trayButton.contains(event.target)) toggleTray(false);
  for (const menu of document.querySelectorAll("details.menu[open]")) if (!menu.contains(event.target)) menu.open = false;
});

const UPKEEP = ["backup", "check", "compact"]; // what they found is said in the tray, and nowhere else
const canBeRepaired = ({ kind, state, codes }) => kind === "check" && state === "done" && codes.notes.at(-1)?.code === "library_check.damaged" && !codes.notes.some(({ code }) => code === "studio_jobs.repair_closed");

function describeJob(job) {
  const act = (name, action, kind = "") => h("button", { type: "button", class: `small ${kind}`, onclick: () => attempt(action) }, t(name));
  const actions = [];
  if (isActive(job)) actions.push(act("stop", () => stopJob(job.id)));
  else actions.push(act("forget", () => forgetJob(job.id), "quiet"));
  if (job.resumable && (job.state === "stopped" || job.state === "failed")) actions.unshift(act("resume", () => resumeJob(job.id)));
  const shows = Object.hasOwn(PLACES, job.kind) && job.state !== "failed";
  if (job.kind === "export" && job.state === "done") actions.unshift(h("a", { class: "button small", href: `/api/exports/${job.id}`, download: "" }, t("download_file")));
  if (canBeRepaired(job)) actions.unshift(act("repair_library", () => post("/jobs/check", { repair: true })));
  if (shows) actions.unshift(h("a", { class: "button small", href: placeOf(job) }, t("show")));
  return h(
    "article",
    { class: "job", dataset: { job: job.id, state: job.state } },
    h("header", {}, h("b", {}, t("job_title", { kind: t(`kind_${job.kind}`), title: job.title })), h("span", { class: "state" }, t(`state_${job.state}`))),
    isActive(job) ? h("progress", { max: String(Math.max(job.total, 1)), value: job.total && job.done ? String(job.done) : null, "aria-label": t(`kind_${job.kind}`) }) : null,
    isActive(job) && job.what ? h("p", { class: "what" }, job.total ? `${job.what} (${job.done}/${job.total})` : job.what) : null,
    h("p", { class: "what job-times", dataset: { job: job.id } }, sayTimes(job)),
    ...(UPKEEP.includes(job.kind) ? job.notes.map((note) => h("p", { class: "what" }, note)) : []),
    job.problem ? h("p", { class: "problem-box" }, job.problem) : null,
    h("div", { class: "actions" }, ...actions),
  );
}

// Labels, evaluations and estimates are results to come back to; of the others nothing but a line is left.
const canBeCleared = (job) => !isActive(job) && (job.state !== "done" || ["add", "watch", "train", "export", "demo", "review", "map", ...UPKEEP].includes(job.kind));

async function clearEnded(ended) {
  for (const job of ended) await forgetJob(job.id);
}

function describeTray(jobs) {
  const ended = jobs.filter(canBeCleared);
  const clear = ended.length > 1 ? h("button", { type: "button", class: "small", id: "jobs-clear", title: t("jobs_clear_title"), onclick: () => attempt(() => clearEnded(ended)) }, t("jobs_clear", { count: ended.length })) : null;
  return h("div", { class: "row tray-tools" }, ...[tellSwitch(), clear].filter(Boolean));
}

let shown = [];
setInterval(() => {
  if (tray.hidden || document.hidden) return;
  for (const element of tray.querySelectorAll(".job-times")) {
    const job = shown.find((one) => one.id === element.dataset.job);
    if (job && isActive(job)) element.textContent = sayTimes(job);
  }
}, 1000);

watchJobs((jobs) => {
  shown = jobs;
  tellEnds(jobs);
  const active = jobs.filter(isActive).length;
  trayButton.classList.toggle("busy", active > 0);
  $("#jobs-count").hidden = !active;
  $("#jobs-count").textContent = String(active);
  const place = focusedPlace();
  tray.replaceChildren(...(jobs.length ? [describeTray(jobs), ...jobs.slice(0, 30).map(describeJob)] : [h("p", {}, t("jobs_none"))]), space);
  if (place) focusAgain(place);
});

listenForPalette((job) => (Object.hasOwn(PLACES, job.kind) && job.state !== "failed" ? placeOf(job) : null));

const size = (bytes) => (bytes < 999.5e6 ? t("megabytes", { value: Math.round(bytes / 1e6) }) : t("gigabytes", { value: (bytes / 1e9).toFixed(1) }));

const LARGE = 1e9; // bytes of a library from which fragments are worth it

async function showSpace(answer = null) {
  const now = answer ?? (await get("/space").catch(() => null)); // the studio is away, which is said elsewhere
  if (!now) return;
  const free = async (asked = "") => {
    const done = await attempt(() => post(`/space/free${asked}`));
    if (!done) return;
    notify(t("space_freed", { size: size(done.freed_bytes) }));
    showSpace(done);
  };
  const start = (name, request) => attempt(() => post(`/jobs/${name}`, request));
  const button = (id, title, text, onclick) => h("button", { type: "button", class: "small", id: `space-${id}`, title, onclick }, text);
  const sure = () => (compact.dataset.sure ? start("compact", {}) : ((compact.dataset.sure = "1"), (compact.textContent = t("space_forget_sure"))));
  const compact = button("compact", t("space_forget_title"), t("space_forget", { size: size(now.removed_bytes) }), sure);
  const check = button("check", t("space_check_title"), t("space_check"), () => start("check", {}));
  const backup = button("backup", t("space_backup_title"), t("space_backup"), () => start("backup", {}));
  const move = button("fragments", t("space_fragments_title"), t("space_fragments"), () => start("compact", { fragments: true }));
  const act = button("free", t("space_free_title"), t("space_free", { size: size(now.can_be_freed_bytes) }), () => free());
  const old = button("old", t("space_old_title", { days: now.oldest_days }), t("space_old", { size: size(now.old_bytes) }), () => free("?older_days=30"));
  const kept = size(now.uploads_bytes + now.jobs_bytes);
  space.replaceChildren(h("p", {}, t("space", { library: size(now.library_bytes), kept, free: size(now.disk_free_bytes) })), ...(now.can_be_freed_bytes > 0 ? [act] : []), ...(now.old_bytes > 0 ? [old] : []), ...(now.removed_bytes > 0 ? [compact] : []), ...(now.library_bytes > LARGE && !now.has_fragments ? [move] : []), backup, check);
}

/** Which job of the tray has the focus, and which of its buttons; the tray itself has none. */
function focusedPlace() {
  const job = tray.contains(document.activeElement) ? document.activeElement.closest(".job") : null;
  return job && { id: job.dataset.job, at: [...job.querySelectorAll("a, button")].indexOf(document.activeElement) };
}

function focusAgain({ id, at }) {
  const acts = [...tray.querySelectorAll(`[data-job="${id}"] :is(a, button)`)];
  (acts[Math.min(at, acts.length - 1)] ?? tray).focus();
}
