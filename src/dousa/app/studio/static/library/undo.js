// Taking a relabelling back, and doing it again: control Z, control shift Z. What was done stands in the tab's storage,
// so that it outlives a reload.

import { post } from "../core/api.js";
import { h, language, t } from "../core/dom.js";
import { attempt, notify } from "../core/notices.js";

const KEY = "dousa-relabelled";
const MOST = 20; // steps
const count = new Intl.NumberFormat(language);

function read() {
  try {
    return JSON.parse(sessionStorage.getItem(KEY)) ?? { done: [], undone: [] };
  } catch {
    return { done: [], undone: [] };
  }
}

function write(steps) {
  try {
    sessionStorage.setItem(KEY, JSON.stringify({ done: steps.done.slice(-MOST), undone: steps.undone.slice(-MOST) }));
  } catch {
    sessionStorage.removeItem(KEY); // too large to be kept: nothing is better than half
  }
}

/** Remember a relabelling by the requests that take it back. */
export function rememberRelabelling(before) {
  if (before.length) write({ done: [...read().done, before], undone: [] });
}

async function step(from, to, word) {
  const steps = read();
  const requests = steps[from].pop();
  if (!requests) return false;
  const back = [];
  for (const request of requests) back.push(...(await post("/clips/relabel", request)).before);
  steps[to].push(back);
  write(steps);
  notify(t(word, { count: count.format(requests.reduce((sum, one) => sum + one.clips.length, 0)) }));
  return true;
}

export const undo = () => step("done", "undone", "undone_labels");
export const redo = () => step("undone", "done", "redone_labels");

/** Keys on the whole page, but for fields, which have an undo of their own. */
export function listenForUndo(changed) {
  document.addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.altKey || event.target.closest?.("input, textarea, select, dialog")) return;
    const key = event.key.toLowerCase();
    const action = key === "z" ? (event.shiftKey ? redo : undo) : key === "y" ? redo : null;
    if (!action) return;
    event.preventDefault();
    attempt(async () => (await action()) && changed());
  });
}

/** A button for the notice of a relabelling. */
export function undoButton(changed) {
  const button = h("button", { type: "button", class: "small", id: "undo", onclick: () => attempt(async () => {
    button.disabled = true;
    if (await undo()) changed();
  }) }, t("undo_labels"));
  return button;
}
