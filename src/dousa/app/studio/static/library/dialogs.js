// Dialogs of this page: new labels, removal.

import { post } from "../core/api.js";
import { foot, openDialog } from "../core/dialog.js";
import { h, icon, language, t } from "../core/dom.js";
import { attempt, notify } from "../core/notices.js";
import { undoButton } from "../core/undo.js";

const count = new Intl.NumberFormat(language);

// --- labels

/** facets: {category: {name: n}, performer: {name: n}} for suggestions; done() after the change */
export async function openRelabel(ids, facets, done) {
  const fields = ["category", "performer"].map((name) => labelField(name, Object.keys(facets[name] ?? {}).filter(Boolean)));
  const save = h("button", { type: "submit", class: "primary", id: "relabel-save", disabled: true }, t("save"));
  const form = h("form", { class: "stack" }, h("p", { class: "note" }, t("relabel_note", { count: count.format(ids.length) })), ...fields.map((field) => field.element), foot(h("button", { type: "button", onclick: () => close() }, t("cancel")), save));
  form.addEventListener("input", () => {
    save.disabled = fields.every((field) => field.value === undefined);
  });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const labels = Object.fromEntries(fields.filter((field) => field.value !== undefined).map((field) => [field.name, field.value]));
    save.disabled = true;
    attempt(async () => {
      const { changed, missing, change } = await post("/clips/relabel", { clips: ids, ...labels });
      close();
      notify([t("relabelled", { count: count.format(changed) }), missing ? t("were_gone", { count: count.format(missing) }) : ""].filter(Boolean).join(" "), "note", undoButton(change, done));
    }).finally(() => {
      save.disabled = false;
      done();
    });
  });
  const { close } = openDialog(t("relabel"), form);
  fields[0].focus();
}

function labelField(name, known) {
  const id = `labels-${name}`;
  const input = h("input", { type: "text", id: `relabel-${name}`, list: id, maxlength: "200", placeholder: t("stays"), autocomplete: "off" });
  const none = h("input", { type: "checkbox", id: `relabel-no-${name}`, onchange: () => (input.disabled = none.checked) });
  const list = h("datalist", { id }, ...known.sort((a, b) => a.localeCompare(b, language, { numeric: true })).map((value) => h("option", { value })));
  const element = h("div", { class: "label-row" }, h("label", { class: "field" }, t(`facet_${name}`), input), h("label", { class: "check" }, none, t("take_away")), list);
  return {
    name,
    element,
    focus: () => input.focus(),
    /** undefined: stays as it is */
    get value() {
      return none.checked ? null : input.value.trim() || undefined;
    },
  };
}

// --- removal

export function openRemove(ids, names, done) {
  const go = h("button", { type: "button", class: "danger", id: "remove-go" }, icon("trash"), t("remove_go", { count: count.format(ids.length) }));
  go.addEventListener("click", () => {
    go.disabled = true;
    attempt(async () => {
      const { removed, change } = await post("/clips/remove", { clips: ids });
      notify(t("removed", { count: count.format(removed) }), "note", undoButton(change, done));
    }).finally(() => {
      close();
      done();
    });
  });
  const keep = h("button", { type: "button", onclick: () => close() }, t("cancel"));
  const some = names.slice(0, 6).map((name) => h("li", {}, name));
  if (names.length && ids.length > some.length) some.push(h("li", { class: "note" }, t("and_more", { count: count.format(ids.length - some.length) })));
  const { close } = openDialog(
    t("remove_title"),
    h("div", { class: "stack" }, h("p", {}, t("remove_note", { count: count.format(ids.length) })), some.length ? h("ul", { class: "plain-list" }, ...some) : null, foot(keep, go)),
  );
  keep.focus(); // the harmless one
}
