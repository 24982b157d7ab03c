// Adding files: upload, a few questions, the job, the report. The job outlives the page: its report is found again by
// its number in the address.

import { post, remove, uploadAll } from "../core/api.js";
import { foot, openDialog } from "../core/dialog.js";
import { dropZone, LABEL_FILES, MOTION_FILES, refusedList } from "../core/drop.js";
import { h, language, t } from "../core/dom.js";
import { followJob, isActive, stopJob } from "../core/jobs.js";
import { attempt, notify } from "../core/notices.js";
import { inAddress } from "./places.js";
import { askHow } from "./rules.js";
import { report } from "./report.js";

const count = new Intl.NumberFormat(language);
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

/** What was uploaded and not added is of no use to anybody. */
async function leave(state) {
  window.removeEventListener("pagehide", gone);
  await state.uploading?.catch(() => {}); // stopped; the last file may just have arrived
  if (state.batch && !state.job) await remove(`/uploads/${state.batch}`).catch(() => {}); // a week later it goes by itself
}

function gone() {
  if (open?.batch && !open.job) fetch(`/api/uploads/${open.batch}`, { method: "DELETE", keepalive: true, credentials: "same-origin" });
}

export const zone = (onEntries, id = "add-files") => dropZone(onEntries, { accept: `${MOTION_FILES},${LABEL_FILES}`, folders: true, hint: t("add_hint"), id });

// --- upload

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

// --- questions

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
      keepRefused(state);
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

function keepRefused({ job, refused }) {
  try {
    sessionStorage.setItem(remembered(job), JSON.stringify(refused.slice(0, 2000)));
  } catch {
    // no room: the report lists what the job refused
  }
}

function refusedOf(id) {
  try {
    return JSON.parse(sessionStorage.getItem(remembered(id)) ?? "[]");
  } catch {
    return [];
  }
}

// --- the job

function show(body, job, { close, hooks }) {
  if (!isActive(job)) {
    body.replaceChildren(...report(job, refusedOf(job.id), { close, hooks, back: open?.files.length ? open.back : null }));
    body.querySelector(".foot .primary")?.focus();
    return;
  }
  body.replaceChildren(
    h("p", { role: "status" }, job.state === "queued" ? t("waits") : !job.total ? t("adding_begins") : t("adding_now", { done: count.format(job.done), total: count.format(job.total) })),
    h("progress", { max: String(Math.max(job.total, 1)), value: job.total ? String(job.done) : null, "aria-label": t("kind_add") }),
    h("p", { class: "note one-line" }, job.what || " "),
    h("p", { class: "note" }, t("add_close_note")),
    foot(h("button", { type: "button", class: "danger", disabled: job.state === "stopping", onclick: () => attempt(() => stopJob(job.id)) }, t("stop")), h("button", { type: "button", onclick: close }, t("close"))),
  );
}
