// What can be done with the chosen clips: a bar at the foot of the page.

import { $, h, icon, language, t } from "../core/dom.js";
import { attempt } from "../core/notices.js";
import { openRelabel, openRemove } from "./dialogs.js";
import { openKeep, openTags, toggleStars } from "./tags.js";

const MOST_REFERENCES = 20;
const count = new Intl.NumberFormat(language);

/** Addresses of other pages that take these clips. */
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

/** hooks: facets(), open(clip), changed(), kept() */
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
