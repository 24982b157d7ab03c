// Sentences of the estimation in the page's language, as far as they are known; others stay as they came.

import { t } from "../core/dom.js";

const KNOWN = [
  [/^one view does not tell how far away anything is/, "say_one_view", []],
  [/^model and silhouettes overlap by (\S+) only/, "say_little_overlap", ["share"]],
  [/^model and silhouettes overlap by (\S+), less than usual/, "say_less_overlap", ["share"]],
  [/^in (\d+) of (\d+) frames the model does not cover/, "say_lost", ["count", "total"]],
  [/^the track was lost and taken up anew at frame (.+)$/, "say_restart", ["frames"]],
  [/^the calibration is missing/i, "say_no_cameras", []],
  [/^the silhouettes are missing/i, "say_no_sources", []],
  [/^(view '.+'): (\d+) of (\d+) silhouettes reach the border/, "say_cut", ["view", "count", "total"]],
  [/a stature of (\S+) m is assumed/, "say_stature", ["value"]],
  [/^(.+): images do not say their frame rate; (\S+) Hz is assumed/, "say_rate", ["view", "value"]],
  [/^stature (\S+) m, given/, "say_body_given", ["value"]],
  [/^stature (\S+) m, said by/, "say_body_known", ["value"]],
  [/^stature told by the silhouettes/, "say_body_told", []],
  [/^stature told by the start/, "say_body_start", []],
  [/^going on at frame (\d+) of (\d+)/, "going_on", ["frame", "total"]],
];

/** A sentence for people. */
export function say(text) {
  for (const [pattern, word, names] of KNOWN) {
    const found = text.match(pattern);
    if (found) return t(word, Object.fromEntries(names.map((name, index) => [name, found[index + 1]])));
  }
  const begin = /^\S+:/.test(text) ? text.charAt(0) : text.charAt(0).toUpperCase(); // names stay as they are
  return begin + text.slice(1) + (/[.?!。]$/.test(text) ? "" : ".");
}

const STEPS = [
  [/^opening/, "what_opening"],
  [/^getting ready/, "what_ready"],
  [/^looking for the first pose/, "what_pose"],
  [/^tracking/, "what_tracking"],
  [/^writing/, "what_writing"],
  [/^overlay video/, "what_video"],
  [/background/, "what_background"],
];

/** What a job is doing. */
export function sayStep(job) {
  if (job.state === "queued") return t("what_waiting");
  const known = STEPS.find(([pattern]) => pattern.test(job.what));
  return known ? t(known[1], { done: job.done, total: job.total }) : job.what;
}
