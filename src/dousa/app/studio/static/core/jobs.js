// Work under way: one poll for the whole page tells everybody who follows a job.

import { get, post, remove } from "./api.js";
import { notify, withdraw } from "./notices.js";

const [QUICK, SLOW] = [350, 4000]; // ms between looks
const ACTIVE = new Set(["queued", "running", "stopping"]);
const followers = new Map(); // job id -> set of functions
const watchers = new Set();
const versions = new Map();
let timer = 0;
let jobs = [];

export const isActive = (job) => ACTIVE.has(job.state);
export const stopJob = (id) => post(`/jobs/${id}/stop`).then(look);
export const resumeJob = (id) => post(`/jobs/${id}/resume`).then(look);
export const forgetJob = (id) => remove(`/jobs/${id}`).then(look);

/** onChange(job) now and after every change, with its result once it is done. -> function that ends it. */
export function followJob(id, onChange) {
  if (!followers.has(id)) followers.set(id, new Set());
  followers.get(id).add(onChange);
  get(`/jobs/${id}`).then(onChange, () => {});
  look();
  return () => followers.get(id)?.delete(onChange);
}

export function finished(id) {
  return new Promise((resolve) => {
    const end = followJob(id, (job) => {
      if (!isActive(job)) {
        end();
        resolve(job);
      }
    });
  });
}

/** onChange(jobs) now and after every change of any job, without their results. */
export function watchJobs(onChange) {
  watchers.add(onChange);
  look();
}

let looking = false;
let missed = 0; // looks one after the other that failed
let said = null; // what was said about that

async function look() {
  if (looking) return;
  looking = true;
  clearTimeout(timer);
  try {
    jobs = (await get("/jobs")).jobs;
    back();
    await tell().catch(() => {}); // a job that is gone since; the next look knows
  } catch (error) {
    away(error.message); // the next look may find it again
  }
  looking = false;
  const hurry = jobs.some(isActive) && !document.hidden;
  timer = setTimeout(look, hurry ? QUICK : SLOW);
}

/** Whoever looks at a page of a studio that is gone should not have to guess. */
function away(problem) {
  missed += 1;
  if (missed < 2 || said === problem) return;
  if (said) withdraw(said);
  said = problem;
  notify(problem, "problem");
}

function back() {
  if (said) withdraw(said);
  [missed, said] = [0, null];
}

async function tell() {
  const changed = jobs.filter((job) => versions.get(job.id) !== job.version);
  const gone = [...versions.keys()].filter((id) => !jobs.some((job) => job.id === id));
  for (const id of gone) versions.delete(id);
  for (const job of changed) {
    versions.set(job.id, job.version);
    const listeners = [...(followers.get(job.id) ?? [])];
    if (!listeners.length) continue;
    const whole = isActive(job) ? job : await get(`/jobs/${job.id}`);
    for (const listener of listeners) listener(whole);
  }
  if (changed.length || gone.length || !versions.size) for (const watcher of [...watchers]) watcher(jobs);
}

document.addEventListener("visibilitychange", () => document.hidden || look());
