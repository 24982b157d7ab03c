// What the teacher says of a performance: kept as it is typed, printed, and in the report that is downloaded.

import { put } from "../core/api.js";
import { h, t } from "../core/dom.js";
import { notify } from "../core/notices.js";

const REST = 600; // ms without a key before it is kept

/** Fills a section; -> function that keeps at once what was typed last. */
export function putNotes(section, job, notes) {
  let kept = notes;
  let waiting = null;
  const state = h("span", { class: "note", role: "status" });
  const field = h("textarea", { id: "notes", rows: "3", maxlength: "20000", placeholder: t("notes_placeholder"), "aria-labelledby": "notes-title" });
  const printed = h("p", { class: "notes-said only-print", "aria-hidden": "true" }, notes);
  field.value = notes;
  const fit = () => {
    field.style.height = "auto";
    field.style.height = `${field.scrollHeight + 2}px`;
  };
  const keep = async () => {
    clearTimeout(waiting);
    const typed = field.value;
    if (typed === kept) return;
    try {
      await put(`/evaluations/${job}/notes`, { notes: typed });
      kept = typed;
      state.textContent = t("notes_kept");
    } catch (error) {
      state.textContent = t("notes_not_kept");
      notify(error.message, "problem");
    }
  };
  field.addEventListener("input", () => {
    printed.textContent = field.value;
    section.classList.toggle("is-empty", !field.value.trim());
    state.textContent = "";
    fit();
    clearTimeout(waiting);
    waiting = setTimeout(keep, REST);
  });
  field.addEventListener("change", keep);
  section.classList.toggle("is-empty", !notes.trim());
  section.replaceChildren(h("div", { class: "title-row" }, h("h2", { id: "notes-title" }, t("notes")), state), field, printed);
  fit();
  return keep;
}
