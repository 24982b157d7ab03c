// Taking a change of the library back, and doing it again. The library itself knows what was changed, so this works
// after a restart, and for what was done elsewhere.

import { post } from "./api.js";
import { h, t } from "./dom.js";
import { attempt, notify } from "./notices.js";

let acting = false;

export const undo = (changed, number = null) => step("undo", "redo", number, changed);
export const redo = (changed, number = null) => step("redo", "undo", number, changed);

async function step(name, back, number, changed) {
  if (acting) return;
  acting = true;
  const change = await attempt(() => post(`/journal/${name}`, { number }));
  acting = false; // the next step does not wait until the page shows this one
  if (!change) return;
  notify(t(`${name}_done`, { what: change.what }), "note", button(back, change.number, changed));
  await attempt(() => changed(change));
}

function button(name, number, changed) {
  const act = () => {
    element.disabled = true;
    (name === "undo" ? undo : redo)(changed, number);
  };
  const element = h("button", { type: "button", class: "small", dataset: { act: name }, onclick: act }, t(name));
  return element;
}

/** A button for the notice of a change, by the number that the answer gives; null where nothing changed. */
export const undoButton = (number, changed) => (number === null ? null : button("undo", number, changed));

/** Control Z, control shift Z, control Y on the whole page, but for fields, which have an undo of their own. */
export function listenForUndo(changed) {
  document.addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.altKey || event.target.closest?.("input:not([type=checkbox]), textarea, select, dialog")) return;
    const key = event.key.toLowerCase();
    const action = key === "z" ? (event.shiftKey ? redo : undo) : key === "y" ? redo : null;
    if (!action) return;
    event.preventDefault();
    if (event.repeat) return; // held down: one change at a time
    action(changed);
  });
}
