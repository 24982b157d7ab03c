// What can be done with the chosen clips: a bar at the foot of the page.

import { post } from "../core/api.js";
import { foot, openDialog } from "../core/dialog.js";
import { $, count, h, icon, language, t } from "../core/dom.js";
import { attempt, notify } from "../core/notices.js";
import { undoButton } from "../core/undo.js";
import { openKeep, openTags, toggleStars } from "./tags.js";

// Dialogs of this page: new labels, removal.

/** facets: {category: {name: n}, performer: {name: n}} for suggestions; done() after the change */
async function openRelabel(ids, facets, done) {
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

function openRemove(ids, names, done) {
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

const MOST_REFERENCES = 20;

export function placesFor(clips) {
  const [clip] = clips;
  const places = [];
  if (!clips.length || !clips.every(Boolean)) return places;
  if (clips.length === 1 && clip.kind !== "take") places.push(["search_with", `/search?motion=${clip.motion}`, "search"]);
  if (clips.length === 1 && clip.kind === "take") places.push(["open_take", `/takes?motion=${clip.motion}`, "play"]);
  if (clips.length <= MOST_REFERENCES) places.push(["evaluate_with", `/evaluate?references=${clips.map((one) => one.motion).join(",")}`, "mark"]);
  return places;
}

export const link = ([word, href, shape]) => h("a", { class: "button", href }, icon(shape), t(word));

export class Actions {
  constructor(selection, hooks) {
    Object.assign(this, { selection, hooks, element: $("#actions"), shown: "" });
  }

  /** What is shown stays as long as it is right: a button that is replaced while somebody presses it is not pressed. */
  show() {
    const { selection, element } = this;
    const { single } = selection;
    const places = placesFor([...selection.clips.values()]);
    const shown = JSON.stringify([selection.size, selection.hidden, Boolean(single), places]);
    if (shown === this.shown) return;
    this.shown = shown;
    const focused = element.contains(document.activeElement) ? document.activeElement.dataset.word : null;
    element.hidden = selection.size === 0;
    document.body.classList.toggle("choosing", selection.size > 0);
    if (element.hidden) {
      element.replaceChildren();
      return;
    }
    const act = (word, shape, action, kind = "") => h("button", { type: "button", class: kind, dataset: { word }, onclick: action }, icon(shape), t(word));
    element.replaceChildren(
      h("b", { class: "chosen-count" }, t("chosen", { count: count.format(selection.size) }), selection.hidden ? h("span", { class: "note" }, ` ${t("chosen_hidden", { count: count.format(selection.hidden) })}`) : null),
      ...(single ? [act("look", "play", () => this.hooks.open(selection.single))] : []),
      ...places.map(link),
      act("export", "download", () => this.export()),
      act("relabel", "label", () => this.relabel()),
      act("tags", "tag", () => this.tag()),
      act("keep", "star", () => this.keep()),
      act("remove", "trash", () => this.remove(), "danger"),
      h("button", { type: "button", class: "quiet icon", "aria-label": t("choose_none"), title: t("choose_none"), dataset: { word: "none" }, onclick: () => selection.clear() }, icon("close")),
    );
    if (focused) element.querySelector(`[data-word="${focused}"]`)?.focus();
  }

  async export(ids = this.selection.ids) {
    (await import("../core/exporting.js")).openExport(ids);
  }

  relabel(ids = this.selection.ids) {
    attempt(async () => openRelabel(ids, await this.hooks.facets(), () => this.hooks.changed()));
  }

  tag(ids = this.selection.ids, clips = [...this.selection.clips.values()]) {
    attempt(async () => openTags(ids, clips, (await this.hooks.facets()).tag ?? {}, () => this.hooks.changed()));
  }

  star(ids = this.selection.ids, clips = [...this.selection.clips.values()]) {
    return toggleStars(ids, clips, () => this.hooks.changed());
  }

  keep() {
    openKeep({ clips: this.selection.ids }, t("keep_selection_note", { count: count.format(this.selection.size) }), () => this.hooks.kept());
  }

  remove(clips = [...this.selection.clips.values()], ids = this.selection.ids) {
    const done = () => {
      this.selection.clear();
      this.hooks.changed();
    };
    openRemove(ids, clips.filter(Boolean).map((clip) => clip.name), done);
  }
}
