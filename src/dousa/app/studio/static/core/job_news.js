// How long a job takes, and word of its end for who looks at something else meanwhile.

import { formatSeconds, h, t } from "./dom.js";
import { isActive } from "./jobs.js";

const SOON = 3; // s before which nothing can be foretold

/** "12.0 s, about 1:30 to go"; after its end how long it took. */
export function sayTimes(job, now = Date.now() / 1000) {
  if (!job.started_s) return "";
  const spent = Math.max((job.finished_s ?? now) - job.started_s, 0);
  if (!isActive(job)) return job.finished_s ? t("job_took", { time: formatSeconds(spent) }) : "";
  const left = spent >= SOON && job.done > 0 && job.total > job.done ? (spent / job.done) * (job.total - job.done) : null;
  return left === null ? formatSeconds(spent) : t("job_left", { time: formatSeconds(spent), left: formatSeconds(left) });
}

/** Keeps the times of what is under way up to date: elements of `root` with data-started. */
export function keepTimes(root, jobs) {
  setInterval(() => {
    if (root.hidden || document.hidden) return;
    for (const element of root.querySelectorAll(".job-times")) {
      const job = jobs().find((one) => one.id === element.dataset.job);
      if (job && isActive(job)) element.textContent = sayTimes(job);
    }
  }, 1000);
}

const KEY = "dousa_tell";
const able = () => "Notification" in window;
const wanted = () => able() && Notification.permission === "granted" && localStorage.getItem(KEY) === "yes";

/** A switch: word of the end of jobs while another page is looked at. Nothing where the browser has no such thing. */
export function tellSwitch() {
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

/** Tell of jobs that have ended since the last call. */
export function tellEnds(jobs) {
  for (const job of jobs) {
    const ended = before.get(job.id) && !isActive(job);
    before.set(job.id, isActive(job));
    if (!ended || !document.hidden || !wanted()) continue;
    const title = t("job_title", { kind: t(`kind_${job.kind}`), title: job.title });
    const note = new Notification(title, { body: job.problem ?? t(`state_${job.state}`), tag: job.id });
    note.addEventListener("click", () => window.focus());
  }
}
