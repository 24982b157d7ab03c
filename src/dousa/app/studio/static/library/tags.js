// Tags of the chosen clips, searches and selections that are kept.

import { get, post } from "../core/api.js";
import { foot, openDialog } from "../core/dialog.js";
import { count, h, icon, language, t } from "../core/dom.js";
import { attempt, notify } from "../core/notices.js";
import { undoButton } from "../core/undo.js";

export const FAVOURITE = "favourite";
const FEW = 2000; // clips whose own tags are looked at

export const nameTag = (tag) => (tag === FAVOURITE ? `★ ${t("favourite")}` : tag);

async function changeTags(ids, add, remove, done) {
  const { changed, change } = await post("/clips/tag", { clips: ids, add, remove });
  notify(t("tagged", { count: count.format(changed) }), "note", undoButton(change, done));
  await done();
  return changed;
}

export function toggleStars(ids, clips, done) {
  const have = clips.length === ids.length && clips.every((clip) => clip?.tags.includes(FAVOURITE));
  return attempt(() => changeTags(ids, have ? [] : [FAVOURITE], have ? [FAVOURITE] : [], done));
}

/** known: {tag: number of clips} of the library; clips: those of the chosen that are known */
export function openTags(ids, clips, known, done) {
  const wanted = new Map(); // tag -> true: give, false: take away
  const look = clips.filter(Boolean).slice(0, FEW);
  const share = (tag) => (look.length < ids.length ? null : look.filter((clip) => clip.tags.includes(tag)).length / look.length);
  const list = h("div", { class: "tag-list" });
  const save = h("button", { type: "submit", class: "primary", id: "tags-save", disabled: true }, t("save"));
  const field = h("input", { type: "text", id: "tag-new", maxlength: "100", autocomplete: "off", placeholder: t("tag_new"), "aria-label": t("tag_new") });
  const names = () => [...new Set([FAVOURITE, ...Object.keys(known).filter(Boolean).sort((a, b) => a.localeCompare(b, language, { numeric: true })), ...wanted.keys()])];
  const choose = (name, tag, give, text) => {
    const chosen = wanted.get(tag) === give;
    return h("button", { type: "button", class: "small", "aria-pressed": String(chosen), "aria-label": t(name, { name: nameTag(tag) }), title: t(name, { name: nameTag(tag) }), onclick: () => {
      if (chosen) wanted.delete(tag);
      else wanted.set(tag, give);
      show();
    } }, text);
  };
  const row = (tag) => {
    const part = share(tag);
    const state = part === null ? "" : t(part === 1 ? "tag_all" : part === 0 ? "tag_none" : "tag_some");
    return h("div", { class: "tag-row", dataset: { tag } }, h("span", { class: "name" }, nameTag(tag)), h("span", { class: "note" }, state), choose("tag_give", tag, true, "+"), choose("tag_take", tag, false, "−"));
  };
  const show = () => {
    list.replaceChildren(...names().map(row));
    save.disabled = wanted.size === 0;
  };
  const take = () => {
    const tag = field.value.trim();
    if (!tag) return false;
    wanted.set(tag, true);
    field.value = "";
    show();
    return true;
  };
  const plus = h("button", { type: "button", onclick: () => (take(), field.focus()) }, t("tag_add"));
  const form = h("form", { class: "stack" }, h("p", { class: "note" }, t("tags_note", { count: count.format(ids.length) })), h("div", { class: "tag-new" }, field, plus), list, foot(h("button", { type: "button", onclick: () => close() }, t("cancel")), save));
  field.addEventListener("input", () => (save.disabled = wanted.size === 0 && !field.value.trim()));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    take();
    const pick = (give) => [...wanted].filter(([, one]) => one === give).map(([tag]) => tag);
    save.disabled = true;
    attempt(async () => {
      await changeTags(ids, pick(true), pick(false), done);
      close();
    }).finally(() => (save.disabled = wanted.size === 0));
  });
  const { close } = openDialog(t("tags"), form);
  show();
  field.focus();
}

const FILTERS = { text: 0, kind: 0, min_s: 0, max_s: 0, category: 1, performer: 1, tag: 1 };

export function readAsked(query) {
  const asked = {};
  for (const [name, several] of Object.entries(FILTERS)) if (query.has(name)) asked[name] = several ? query.getAll(name) : query.get(name);
  for (const name of ["min_s", "max_s"]) if (name in asked) asked[name] = Number(asked[name]);
  return asked;
}

/** Ask for a name; what: {asked} or {clips} */
export function openKeep(asked, note, done) {
  const field = h("input", { type: "text", id: "keep-name", maxlength: "100", autocomplete: "off", required: true, "aria-label": t("keep_name"), placeholder: t("keep_name") });
  const save = h("button", { type: "submit", class: "primary", id: "keep-save" }, t("save"));
  const form = h("form", { class: "stack" }, h("p", { class: "note" }, note), field, foot(h("button", { type: "button", onclick: () => close() }, t("cancel")), save));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const name = field.value.trim();
    if (!name) return;
    attempt(async () => {
      await post("/searches", { name, asked });
      close();
      notify(t("kept_as", { name }));
      await done();
    });
  });
  const { close } = openDialog(t("keep_title"), form);
  field.focus();
}

/** The list of them, above the facets. hooks: use(search), current() -> name of the selection that is shown */
export async function showKept(element, hooks) {
  const { searches } = await get("/searches");
  const forget = (one) => attempt(async () => {
    await post(`/searches/forget?name=${encodeURIComponent(one.name)}`);
    notify(t("kept_forgotten", { name: one.name }), "note", h("button", { type: "button", class: "small", onclick: (event) => {
      event.currentTarget.disabled = true;
      attempt(async () => {
        await post("/searches", { name: one.name, asked: one.n_clips === null ? one.asked : { clips: one.ids } });
        await showKept(element, hooks);
      });
    } }, t("undo")));
    await showKept(element, hooks);
  });
  const keepIds = async (one) => {
    if (one.n_clips !== null) one.ids = (await get("/clips/ids", { saved: one.name })).ids;
    await forget(one);
  };
  element.hidden = !searches.length;
  const row = (one) =>
    h("li", { class: "kept-row", dataset: { name: one.name } },
      h("button", { type: "button", class: "quiet small kept-name", "aria-pressed": String(hooks.current() === one.name), title: one.name, onclick: () => hooks.use(one) }, icon(one.n_clips === null ? "search" : "mark"), h("span", { class: "name" }, one.name), one.n_clips === null ? null : h("span", { class: "n" }, count.format(one.n_clips))),
      h("button", { type: "button", class: "quiet small icon", "aria-label": t("keep_forget", { name: one.name }), title: t("keep_forget", { name: one.name }), onclick: () => attempt(() => keepIds(one)) }, icon("close")));
  element.replaceChildren(h("h2", {}, t("kept")), h("ul", {}, ...searches.map(row)));
}
