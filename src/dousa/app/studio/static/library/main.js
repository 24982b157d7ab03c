// The library: its clips in a grid, what they are filtered by, what is done with them.

import { get, post } from "../core/api.js";
import { $, count, h, icon, later, t } from "../core/dom.js";
import { acceptDrops } from "../core/drop.js";
import { isActive, watchJobs } from "../core/jobs.js";
import { attempt, notify } from "../core/notices.js";
import { listenForUndo } from "../core/undo.js";
import { Actions } from "./actions.js";
import { Filter, showFacets } from "./facets.js";
import { Grid } from "./grid.js";
import { nothingChosen, Panes, Scroll } from "./panes.js";
import { findAgain, findPlace, fromAddress, keepPlace } from "./places.js";
import { Selection } from "./selection.js";
import { Source } from "./source.js";
import { openKeep, readAsked, showKept } from "./tags.js";
import { readForest, showForest } from "./training.js";

const LOOK_AGAIN = 8000; // ms between looks whether somebody else has changed the library
const many = (thing, number) => t(`n_${thing}_${number === 1 ? "one" : "many"}`, { count: count.format(number) });
const problem = (error) => attempt(() => Promise.reject(error));

const source = new Source({ reset: show, arrived: () => grid.request(true), failed: problem });
const filter = new Filter(() => {
  scroll.to(scroll.isPane ? 0 : Math.min(scroll.top, listTop()));
  attempt(() => source.ask(filter.query));
});
const selection = new Selection({
  changed: () => {
    actions.show();
    grid.request(true);
    map?.request();
    showLook();
  },
  known: (index) => source.item(index),
  findAgain,
  idsBetween: (first, last) => idsOf({ offset: first, limit: last - first + 1 }),
});
const scroll = new Scroll($("#grid-scroll"));
const grid = new Grid($("#grid"), scroll, source, {
  chosen: (id) => selection.has(id),
  click: (index, event) => choose(index, event),
  open: (index) => look(source.item(index)),
  key: (event, index) => press(event, index),
});
const actions = new Actions(selection, {
  // Suggestions are all labels there are, not only those of the filter.
  facets: async () => (await get("/clips", { limit: 0 })).facets,
  open: (clip) => look(clip),
  changed: reload,
  kept: () => showKept($("#kept"), keptHooks),
});
const keptHooks = {
  current: () => filter.get("saved"),
  use: (one) => {
    $("#text").value = one.asked.text ?? "";
    filter.replace(one.n_clips === null ? one.asked : { saved: one.name });
    showKept($("#kept"), keptHooks);
  },
};

const listTop = () => $("#browse").getBoundingClientRect().top + window.scrollY - 70;

async function idsOf(part = {}) {
  const query = new URLSearchParams(source.query); // of the list that is shown
  for (const [name, value] of Object.entries(part)) query.set(name, String(value));
  return (await get(`/clips/ids?${query}`)).ids;
}

function show({ total, facets, library, reading, revision }) {
  const empty = library.n_clips + library.n_takes === 0;
  $("#browse").hidden = empty;
  $("#start").hidden = !empty;
  $("#review-button").hidden = library.n_categories < 2;
  if (empty) showStart();
  const minutes = library.seconds / 60;
  const parts = [many("clip", library.n_clips)];
  if (library.n_takes) parts.push(many("take", library.n_takes));
  parts.push(t("n_minutes", { count: minutes < 10 ? minutes.toFixed(1) : count.format(Math.round(minutes)) }), many("category", library.n_categories));
  $("#numbers").textContent = empty ? t("empty_head") : parts.join(" · ");
  $("#count").textContent = filter.narrows ? t("found_some", { count: count.format(total), total: count.format(library.n_clips + library.n_takes) }) : t("found_all", { count: count.format(total) });
  $("#nothing").hidden = total > 0 || empty;
  $("#all-button").hidden = total === 0;
  $("#all-button").textContent = t("choose_all", { count: count.format(total) });
  attempt(countHidden);
  showChips();
  showReading(reading);
  showFacets($("#facet-form"), facets, filter);
  grid.setTotal(total);
  if (map?.isOpen) attempt(() => (mapOf === revision ? map.narrow() : map.load()));
  mapOf = revision;
  showLook();
}

async function countHidden() {
  const { ids } = selection;
  if (!ids.length) return;
  const shown = filter.narrows ? new Set(await idsOf()) : null;
  selection.hidden = shown ? ids.filter((id) => !shown.has(id)).length : 0;
  actions.show();
}

function showChips() {
  const chip = (text, clear) => h("button", { type: "button", class: "small chip", onclick: clear }, text, icon("close"));
  const chips = [];
  if (filter.get("batch")) chips.push(chip(t("only_batch"), () => filter.set({ batch: null })));
  if (filter.get("saved")) chips.push(chip(t("only_saved", { name: filter.get("saved") }), () => filter.set({ saved: null })));
  if (Object.keys(readAsked(filter.query)).length) chips.push(h("button", { type: "button", class: "quiet small", id: "keep-search", onclick: keepSearch }, icon("star"), t("keep_search")));
  if (filter.narrows) chips.push(h("button", { type: "button", class: "quiet small", onclick: clearFilter }, t("clear_filter")));
  $("#chips").replaceChildren(...chips);
}

/** How the text was understood: what was misspelt, and what else does what it says. */
function showReading({ taken_for: takenFor, more, pending }) {
  const words = Object.entries(takenFor).map(([word, other]) => t("taken_for_word", { word, other }));
  const wide = filter.get("wide") !== "";
  const parts = words.length ? [h("span", { class: "note" }, words.join(t("tally_comma")))] : [];
  if (more || wide) parts.push(h("button", { type: "button", class: "small chip", id: "wide-button", "aria-pressed": String(wide), onclick: () => filter.set({ wide: wide ? null : "true" }) }, wide ? t("wide_on") : t("wide_off", { count: count.format(more) })));
  $("#reading").replaceChildren(...parts);
  clearTimeout(askAgain);
  // The words of a large library are read aside; what they find comes a little later.
  if (pending) askAgain = setTimeout(() => source.ask(filter.query).catch(() => {}), 700);
}
let askAgain = 0;

async function showStart() {
  if ($("#start").children.length) return;
  const { zone } = await import("./adding.js");
  $("#start").replaceChildren(
    h("div", { class: "start-words" }, h("h2", {}, t("start_title")), h("p", { class: "lead" }, t("start_text"))),
    zone((entries) => add({ entries }), "start-files"),
    h("p", { class: "row start-demo" }, h("span", { class: "note" }, t("start_demo")), h("button", { type: "button", id: "demo-button", onclick: fillWithDemo }, t("start_demo_button"))),
  );
}

function fillWithDemo({ currentTarget }) {
  currentTarget.disabled = true;
  attempt(async () => {
    await post("/jobs/demo");
    notify(t("demo_running"));
  }).finally(() => (currentTarget.disabled = false));
}

function keepSearch() {
  openKeep(readAsked(filter.query), t("keep_search_note"), () => showKept($("#kept"), keptHooks));
}

function clearFilter() {
  $("#text").value = "";
  filter.replace({});
}

function reload() {
  return attempt(async () => {
    await source.ask();
    await selection.refresh();
    showForest(await readForest());
  });
}

function choose(index, event) {
  if (event.shiftKey) attempt(() => selection.extend(index));
  else if (event.ctrlKey || event.metaKey || event.pointerType === "touch" || event.target.closest?.(".tick")) selection.toggle(index);
  else selection.only(index);
}

/** Keys besides the arrows; true if it was one of ours. */
function press(event, index) {
  const clip = source.item(index);
  if (event.key === "a" && (event.ctrlKey || event.metaKey)) chooseAll();
  else if (event.key === " ") event.shiftKey ? attempt(() => selection.extend(index)) : selection.toggle(index);
  else if (event.key === "Enter" && clip) look(clip);
  else if (event.key === "Escape" && selection.size) selection.clear();
  else if (event.key === "Delete" && selection.size) actions.remove();
  else if (event.key === "f" && !event.ctrlKey && !event.metaKey && !event.altKey && (selection.size || clip)) selection.size ? actions.star() : actions.star([clip.id], [clip]);
  else return false;
  return true;
}

const chooseAll = () => attempt(async () => selection.all(await idsOf()));

async function look(clip) {
  if (!clip) return;
  const { openDetail } = await import("./detail.js");
  const indexOf = (one) => {
    const near = grid.active;
    for (let away = 0; away < 400; away += 1) for (const at of [near + away, near - away]) if (source.item(at)?.id === one.id) return at;
    return near;
  };
  openDetail(clip, {
    neighbour: (one, step) => {
      const at = indexOf(one) + step;
      if (at >= 0 && at < source.total) grid.activate(at);
      source.need(Math.max(at - 40, 0), Math.min(at + 40, source.total));
      return source.item(at);
    },
    relabel: (one) => actions.relabel([one.id]),
    tags: (one) => actions.tag([one.id], [one]),
    remove: (one) => actions.remove([one], [one.id]),
    closed: (one) => grid.focus(indexOf(one)),
  });
}

let shown = null; // in the pane

const showLook = later(async () => {
  const clip = selection.single ?? source.item(grid.active);
  if (!panes.isOpen || !clip) return;
  const { Look } = await import("./detail.js");
  if (!shown) {
    shown = new Look((name, one) => ({ relabel: () => actions.relabel([one.id]), tags: () => actions.tag([one.id], [one]), remove: () => actions.remove([one], [one.id]) })[name]());
    $("#look").replaceChildren(shown.title = h("h2", {}), shown.element);
  }
  shown.title.textContent = shown.title.title = clip.name;
  shown.show(clip);
}, 120);

let map = null; // made when it is looked at first
let mapOf = null; // revision of the library that it shows

async function showMap(open) {
  $("#grid-scroll").hidden = open;
  if (!open) {
    map?.hide();
    grid.layout();
    return;
  }
  const { ClipMap } = await import("./map.js");
  map ??= new ClipMap($("#map"), {
    selection,
    narrows: () => filter.narrows,
    fitting: () => idsOf(),
    open: (clip) => look(clip),
    key: (event) => ![" ", "Enter"].includes(event.key) && press(event, -1),
  });
  if (panes.map) map.show();
}

const panes = new Panes({
  map: (open) => attempt(() => showMap(open)),
  grid: (shape) => grid.setLook(shape),
  look: (open) => {
    if (open) showLook();
    else {
      shown?.destroy();
      shown = null;
      $("#look").replaceChildren(nothingChosen());
    }
  },
});

const addHooks = {
  changed: reload,
  showBatch: (batch) => {
    clearFilter();
    filter.set({ batch });
  },
  relabelBatch: (batch) => attempt(async () => actions.relabel((await get("/clips/ids", { batch })).ids)),
};

const add = async (what) => (await import("./adding.js")).openAdding({ ...what, hooks: addHooks });
const train = async (jobId) => (await import("./training.js")).openTraining(jobId, reload);

const review = async (jobId) => (await import("./review.js")).openReview(jobId, { changed: reload, choose: (ids) => selection.all(ids) });

async function openJob(id) {
  const job = await attempt(() => get(`/jobs/${id}`));
  if (["add", "watch"].includes(job?.kind)) add({ jobId: id });
  if (job?.kind === "train") train(id);
  if (job?.kind === "review") review(id);
  if (job?.kind === "map") panes.showMap(true);
}

$("#text").value = filter.get("text");
$("#sort").value = filter.get("sort") || "path";
$("#text").addEventListener("input", later(() => filter.set({ text: $("#text").value.trim(), wide: null }), 80));
$("#sort").addEventListener("change", () => filter.set({ sort: $("#sort").value === "path" ? null : $("#sort").value }));
$("#facet-form").addEventListener("submit", (event) => event.preventDefault());
$("#facets").open = !window.matchMedia("(max-width: 860px)").matches;
$("#clear-filter").addEventListener("click", clearFilter);
$("#all-button").addEventListener("click", chooseAll);
$("#add-button").addEventListener("click", () => add({}));
$("#review-button").addEventListener("click", () => review(null));
$("#train-button").addEventListener("click", () => train(null));
document.documentElement.dataset.dropText = t("drop_page");
acceptDrops(document.documentElement, (entries) => add({ entries }));

// Another tab or program may have written, and jobs of ours end.
const ended = new Map();
watchJobs((jobs) => {
  const over = jobs.filter((job) => ["add", "watch", "train", "demo"].includes(job.kind) && !isActive(job) && ended.get(job.id) === true);
  for (const job of jobs) ended.set(job.id, isActive(job));
  if (over.length) reload();
});
keepPlace({ selection, grid, scroll });
listenForUndo(reload);
const refresh = () => document.hidden || source.refresh().catch(() => {}); // the next look may find it
document.addEventListener("visibilitychange", refresh);
setInterval(refresh, LOOK_AGAIN);

attempt(async () => {
  await source.ask(filter.query);
  findPlace({ selection, grid, scroll });
  attempt(() => showKept($("#kept"), keptHooks));
  showForest(await readForest());
});
if (fromAddress("clip")) attempt(async () => look(await get(`/clips/${encodeURIComponent(fromAddress("clip"))}`)));
if (fromAddress("job")) openJob(fromAddress("job"));
