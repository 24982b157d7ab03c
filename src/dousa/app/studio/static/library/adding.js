// Adding files: upload, a few questions, the job, the report. The job outlives the page: its report is found again by
// its number in the address.

import { post, remove, uploadAll } from "../core/api.js";
import { foot, openDialog, pairTable } from "../core/dialog.js";
import { count, h, icon, keep, recall, t } from "../core/dom.js";
import { dropZone, LABEL_FILES, MOTION_FILES, refusedList } from "../core/drop.js";
import { followJob, isActive, resumeJob } from "../core/jobs.js";
import { attempt, notify } from "../core/notices.js";
import { undo } from "../core/undo.js";
import { inAddress } from "./places.js";
import { waiting } from "./waiting.js";

// What became of the files: added, known already, not taken and why.
const FEW_LINES = 8; // categories that are named in a line

/** -> elements for the dialog; refused: [{name, reason}] of the upload; back() shows the questions again, if there are any */
export function report(job, refused, { close, hooks, back: change }) {
  const done = h("button", { type: "button", class: "primary", onclick: close }, t("close"));
  if (!job.result) {
    const again = job.resumable ? h("button", { type: "button", onclick: () => attempt(() => resumeJob(job.id)) }, t("resume")) : null;
    const differently = change && job.state === "failed" ? h("button", { type: "button", id: "add-back", onclick: change }, t("add_back")) : null;
    return [h("p", { class: "problem-box", role: "alert" }, job.problem ?? t("adding_stopped")), lost(refused, []), foot(...[differently, again, done].filter(Boolean))].filter(Boolean);
  }
  const { result, request } = job;
  const fresh = result.added.length + result.replaced.length;
  const batch = request?.batch;
  const leave = (action) => () => {
    close();
    action(batch);
  };
  const act = (word, action) => h("button", { type: "button", onclick: leave(action) }, t(word));
  const back = fresh && result.change ? [h("button", { type: "button", class: "quiet", id: "undo-adding", onclick: () => (close(), undo(hooks.changed, result.change)) }, icon("undo"), t("undo"))] : [];
  const acts = fresh && batch ? [act("show_added", hooks.showBatch), act("label_added", hooks.relabelBatch), ...back] : [];
  return [
    h("p", { role: "status", id: "add-report", class: "report-head" }, fresh ? icon("mark") : null, t(fresh ? "added_head" : "added_nothing", { count: count.format(fresh), seconds: result.seconds.toFixed(1) })),
    tallyResult(result),
    result.labelled?.length ? h("p", { class: "note", id: "add-labelled" }, t("labelled", { count: count.format(result.labelled.length), segments: count.format(result.n_segments) })) : null,
    lost(refused, result.skipped),
    pairs("duplicates_title", result.duplicates, (item) => [item.path, t("same_as", { name: item.same_as })]),
    pairs("warnings_title", result.warnings, (item) => [item.path, item.warning]),
    pairs("other_labels_title", result.other_labels, (path) => [path, t("labels_stay")]),
    pairs("other_kind_title", result.other_kind, (path) => [path, t("kind_stays")]),
    newCategories(result.new_categories),
    foot(...acts, done),
  ].filter(Boolean);
}

function newCategories(names) {
  if (!names.length) return null;
  if (names.length <= FEW_LINES) return h("p", { class: "note" }, t("new_categories", { names: names.join(t("tally_comma")) }));
  return h("details", { id: "add-categories" }, h("summary", {}, t("new_categories_title", { count: count.format(names.length) })), h("ul", { class: "plain-list scroll" }, ...names.map((name) => h("li", {}, name))));
}

function tallyResult(result) {
  const names = ["added", "replaced", "unchanged", "moved", "duplicates", "skipped"];
  const shown = names.filter((name) => result[name].length);
  return h("dl", { class: "tally" }, ...shown.flatMap((name) => [h("div", {}, h("dt", {}, t(`tally_${name}`)), h("dd", {}, count.format(result[name].length)))]));
}

function lost(refused, skipped) {
  const all = [...refused.map(({ name, reason }) => [name, reason]), ...skipped.map(({ path, reason }) => [path, reason])];
  return pairTable("refused_title", all, { kind: "refused", open: true });
}

const pairs = (title, items, cells) => pairTable(title, items.map(cells));

// How the files are added: as what, and where their labels come from, with a look at what comes of it.
const SHOWN = 5;
const DEEPEST = 6; // levels of folders that are offered
const RULES = { folder: "folder", last_folder: "path:([^/]+)/[^/]+$", none: "none", ...levels(DEEPEST) };

/** {level_2: rule, ...}; the first level is the outermost folder. */
function levels(deepest) {
  return Object.fromEntries(Array.from({ length: deepest }, (_, at) => [`level_${at + 1}`, `path:^(?:[^/]+/){${at}}([^/]+)/`]));
}

/** names: of the motions that came, tables: of labels that lie beside some of them -> {element, value: for POST /jobs/add} */
function askHow(names, tables = []) {
  const folders = names.some((name) => name.includes("/"));
  const kind = choice("add-kind", ["clip", "take"].map((name) => [name, t(`add_as_${name}`)]), tables.length ? "take" : "clip");
  const depth = Math.min(Math.max(...names.map((name) => name.split("/").length - 1), 0), DEEPEST);
  const byLevel = depth > 1 ? Object.keys(levels(depth)) : [];
  const byFolder = depth > 1 ? ["folder", "last_folder", ...byLevel] : ["folder"];
  const category = rule("category", [...byFolder, "name", "none"], folders ? "folder" : "none", "^([A-Za-z]+)");
  const performer = rule("performer", ["none", ...(depth > 1 ? byLevel : ["level_1"]), "name"], "none", "_([A-Za-z]+[0-9]*)");
  const unit = h("select", { id: "add-unit" }, ...["", "m", "cm", "mm", "inch", "cmu"].map((name) => h("option", { value: name }, t(`unit_${name || "file"}`))));
  const beside = h("input", { type: "checkbox", id: "add-labels", checked: true });
  const labels = h("label", { class: "check" }, beside, t("labels_beside", { count: tables.length }));
  const unread = h("p", { class: "note", id: "labels-unread" }, t("labels_unread"));
  const preview = h("div", { class: "preview" });
  const element = h(
    "div",
    { class: "stack" },
    kind.element,
    labels,
    unread,
    h("div", { class: "option-row" }, category.element, performer.element),
    preview,
    h("details", {}, h("summary", {}, t("options")), h("label", { class: "field narrow" }, t("unit"), unit)),
  );
  const renew = () => {
    category.element.hidden = kind.value === "take";
    labels.hidden = kind.value !== "take" || !tables.length;
    unread.hidden = kind.value === "take" || !tables.length;
    preview.replaceChildren(...look(names, kind.value === "take" ? null : category, performer));
  };
  element.addEventListener("input", renew);
  renew();
  return {
    element,
    get value() {
      const said = { kind: kind.value, performer_from: performer.value, category_from: kind.value === "take" ? "none" : category.value };
      if (!labels.hidden && beside.checked) said.labels = true;
      return unit.value ? { ...said, unit: unit.value } : said;
    },
  };
}

function choice(name, options, chosen) {
  const inputs = options.map(([value]) => h("input", { type: "radio", name, value, id: `${name}-${value}`, checked: value === chosen }));
  const element = h("div", { class: "row", role: "radiogroup", "aria-label": t("add_as") }, ...options.map(([, text], number) => h("label", { class: "check" }, inputs[number], text)));
  return { element, get value() {
    return inputs.find((input) => input.checked).value;
  } };
}

function rule(name, kinds, chosen, pattern) {
  const select = h("select", { id: `add-${name}` }, ...kinds.map((kind) => h("option", { value: kind, selected: kind === chosen }, wordOf(kind))));
  const text = h("input", { type: "text", id: `add-${name}-pattern`, value: pattern, maxlength: "200", spellcheck: "false", "aria-label": t("pattern_of", { name: t(`facet_${name}`) }) });
  const more = h("span", { class: "pattern" }, text, h("span", { class: "note" }, t("pattern_note")));
  const settle = () => (more.hidden = select.value !== "name");
  select.addEventListener("input", settle);
  settle();
  const element = h("label", { class: "field" }, t(`facet_${name}`), select, more);
  return {
    element,
    get value() {
      return select.value === "name" ? `name:${text.value}` : RULES[select.value];
    },
    /** The label of a file as the rule will very likely find it; null for none. */
    guess(file) {
      const at = file.lastIndexOf("/");
      if (select.value === "none") return null;
      if (select.value === "folder") return at < 0 ? null : file.slice(0, at);
      if (select.value !== "name") return new RegExp(RULES[select.value].slice(5), "u").exec(file)?.[1]?.trim() || null;
      const found = new RegExp(text.value, "u").exec(file.slice(at + 1));
      return found?.[1]?.trim() || null;
    },
  };
}

const wordOf = (kind) => (kind.startsWith("level_") && kind !== "level_1" ? t("from_level", { level: kind.slice(6) }) : t(`from_${kind === "level_1" ? "first_folder" : kind}`));

function tally(names, from, word) {
  const counts = new Map();
  try {
    for (const name of names) {
      const label = from.guess(name);
      if (label !== null) counts.set(label, (counts.get(label) ?? 0) + 1);
    }
  } catch {
    return null; // the table says that the expression is not one
  }
  if (!counts.size) return null;
  const most = [...counts].sort((a, b) => b[1] - a[1]).slice(0, 4).map(([label, number]) => t("tally_label", { label, count: number }));
  return h("p", { class: "note tally-line" }, t(word, { count: counts.size, names: most.join(t("tally_comma")) + (counts.size > most.length ? " …" : "") }));
}

function look(names, category, performer) {
  const label = (from, name) => {
    try {
      return from?.guess(name) ?? "–";
    } catch {
      return t("pattern_bad");
    }
  };
  const step = Math.max(Math.floor(names.length / SHOWN), 1);
  const some = names.filter((_, number) => number % step === 0).slice(0, SHOWN);
  const head = ["file", ...(category ? ["facet_category"] : []), "facet_performer"];
  const row = (name) => h("tr", {}, h("td", {}, name), category ? h("td", {}, label(category, name)) : null, h("td", {}, label(performer, name)));
  return [category ? tally(names, category, "tally_category") : null, tally(names, performer, "tally_performer"), h("table", { "aria-label": t("preview") }, h("thead", {}, h("tr", {}, ...head.map((word) => h("th", { scope: "col" }, t(word))))), h("tbody", {}, ...some.map(row)))].filter(Boolean);
}

const MOTION = /\.(bvh|amc|c3d|trc|npz|npy|pkl|csv|tsv|json|vmd|mvnx|fbx|dae|usd[acz]?|glb|gltf|vrm|vrma)$/i;
const FEW = 4; // tables that are named
const remembered = (id) => `dousa-refused-${id}`; // what an upload refused, for the report of its job
let open = null;

/** hooks: changed() when the library is another, showBatch(batch), relabelBatch(batch), train() */
export function openAdding({ entries, jobId, hooks }) {
  if (open) {
    if (entries) open.take(entries);
    return;
  }
  const body = h("div", { class: "stack adding" });
  let end = () => {};
  const stop = new AbortController();
  const { close } = openDialog(t("add_title"), body, {
    onClose: () => {
      const left = open;
      open = null;
      end();
      stop.abort();
      leave(left);
      inAddress({ job: null });
    },
  });
  const follow = (id) => {
    inAddress({ job: id });
    end = followJob(id, (job) => {
      show(body, job, { close, hooks });
      if (!isActive(job)) hooks.changed();
    });
  };
  open = { batch: null, refused: [], files: [], busy: false, body, close, follow, stop };
  open.back = () => {
    end();
    open.job = null;
    inAddress({ job: null });
    question(open);
  };
  open.take = (more) => attempt(() => receive(open, more));
  window.addEventListener("pagehide", gone);
  if (jobId) follow(jobId);
  else if (entries) open.take(entries);
  else body.replaceChildren(zone((more) => open.take(more)));
}

async function leave(state) {
  window.removeEventListener("pagehide", gone);
  await state.uploading?.catch(() => {}); // stopped; the last file may just have arrived
  if (state.batch && !state.job) await remove(`/uploads/${state.batch}`).catch(() => {}); // a week later it goes by itself
}

function gone() {
  if (open?.batch && !open.job) fetch(`/api/uploads/${open.batch}`, { method: "DELETE", keepalive: true, credentials: "same-origin" });
}

export const zone = (onEntries, id = "add-files") => dropZone(onEntries, { accept: `${MOTION_FILES},${LABEL_FILES}`, folders: true, hint: t("add_hint"), id });

/** A folder that only holds the folders of the categories says nothing: files come as from inside of it. */
function withoutOutermost(entries) {
  const [first] = entries[0].path.split("/");
  const inside = entries.every(({ path }) => path.startsWith(`${first}/`));
  const motions = entries.filter(({ path }) => MOTION.test(path));
  if (!inside || !motions.length || motions.some(({ path }) => path.split("/").length < 3)) return entries;
  return entries.map(({ file, path }) => ({ file, path: path.slice(first.length + 1) }));
}

async function receive(state, entries) {
  if (state.busy || state.job) {
    notify(t("one_at_a_time"), "problem");
    return;
  }
  state.busy = true;
  const bar = h("progress", { max: String(entries.length), value: "0", "aria-label": t("uploading", { done: 0, total: entries.length }) });
  const text = h("p", { role: "status" }, t("uploading", { done: 0, total: count.format(entries.length) }));
  state.body.replaceChildren(text, bar, foot(h("button", { type: "button", class: "danger", onclick: state.close }, t("stop"))));
  const onProgress = (done, total) => {
    bar.value = done;
    text.textContent = t("uploading", { done: count.format(done), total: count.format(total) });
  };
  try {
    const onBatch = (batch) => (state.batch = batch);
    state.uploading = uploadAll(withoutOutermost(entries), { batch: state.batch, onProgress, onBatch, signal: state.stop.signal });
    const came = await state.uploading;
    state.batch = came.batch;
    state.files = [...state.files.filter((one) => !came.files.some((other) => other.name === one.name)), ...came.files];
    state.refused.push(...came.refused);
  } finally {
    state.busy = false;
    if (!state.stop.signal.aborted) question(state);
  }
}

function question(state) {
  const motions = state.files.filter((file) => file.motion);
  if (!motions.length) {
    state.body.replaceChildren(h("p", { role: "status" }, t("no_motions")), refusedList(state.refused) ?? "", zone((more) => state.take(more)));
    return;
  }
  const { beside, alone } = pairTables(motions, state.files.filter((file) => file.labels_of != null));
  const others = state.files.length - motions.length - beside.length - alone.length;
  const how = askHow(motions.map((file) => file.name), beside);
  const go = h("button", { type: "submit", class: "primary", id: "add-go" }, t("add_go", { count: count.format(motions.length) }));
  const form = h(
    "form",
    { class: "stack" },
    h("p", { role: "status", id: "came" }, t("came", { count: count.format(motions.length) }), others ? ` ${t("came_others", { count: count.format(others) })}` : ""),
    beside.length ? h("p", { id: "came-tables" }, t("came_tables", { count: count.format(beside.length), names: some(beside) })) : "",
    alone.length ? h("p", { class: "note", id: "tables-alone" }, t("tables_alone", { names: some(alone) })) : "",
    refusedList(state.refused) ?? "",
    how.element,
    foot(h("button", { type: "button", onclick: state.close }, t("cancel")), go),
  );
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    go.disabled = true;
    attempt(async () => {
      state.job = (await post("/jobs/add", { batch: state.batch, ...how.value })).id;
      keep("sessionStorage", remembered(state.job), state.refused.slice(0, 2000));
      state.follow(state.job);
    }).finally(() => (go.disabled = false));
  });
  state.body.replaceChildren(form);
  go.focus();
}

const some = (names) => names.slice(0, FEW).join(t("tally_comma")) + (names.length > FEW ? ` ${t("and_more", { count: count.format(names.length - FEW) })}` : "");

/** What tables of labels are called: those that lie beside a motion of their name, and those that belong to none. */
function pairTables(motions, tables) {
  const takes = new Set(motions.flatMap(({ name }) => stems(name)));
  const isBeside = (table) => takes.has(stems(`${table.labels_of}.`)[0]);
  return { beside: tables.filter(isBeside).map((table) => table.name), alone: tables.filter((table) => !isBeside(table)).map((table) => table.name) };
}

/** The names that a table of a motion may have, with their folder: without the last suffix, and without all. */
function stems(name) {
  const at = name.lastIndexOf("/") + 1;
  const [folder, file] = [name.slice(0, at), name.slice(at).toLowerCase()];
  return [file.slice(0, file.lastIndexOf(".")), file.split(".")[0]].map((stem) => folder + stem);
}

function show(body, job, { close, hooks }) {
  if (!isActive(job)) {
    body.replaceChildren(...report(job, recall("sessionStorage", remembered(job.id)) ?? [], { close, hooks, back: open?.files.length ? open.back : null }));
    body.querySelector(".foot .primary")?.focus();
    return;
  }
  const said = job.state === "queued" ? t("waits") : !job.total ? t("adding_begins") : t("adding_now", { done: count.format(job.done), total: count.format(job.total) });
  body.replaceChildren(...waiting(job, said, close, h("p", { class: "note one-line" }, job.what || " "), h("p", { class: "note" }, t("add_close_note"))));
}
