// Before an estimation: files find their parts, a person is described, the first silhouettes are looked at.

import { get, post, uploadAll } from "../core/api.js";
import { $, h, icon, later, t } from "../core/dom.js";
import { dropZone, refusedList } from "../core/drop.js";
import { attempt } from "../core/notices.js";
import { addressOf } from "./address.js";
import { showFiles } from "./files.js";
import { buildOptions, readOptions } from "./options.js";
import { showEmpty, showLooking, showPreview } from "./preview.js";

const ACCEPT = ".npz,.zip,.mp4,.avi,.mov,.mkv,.webm,.m4v,.png,.jpg,.jpeg,.bmp,.tif,.tiff,.toml,.xml,.yaml,.yml,.json,.txt,.bvh,.amc,.asf,.c3d,.trc";

const state = { batch: null, files: [], roles: new Map(), look: null, onJob: () => {}, onMasks: () => {}, films: false };

/** options: batch of an earlier upload or null; onJob(id) when an estimation was started, onMasks(id) when its silhouettes are
 *  to be repaired first. */
export function showSetup({ batch, onJob, onMasks }) {
  Object.assign(state, { batch: null, files: [], onJob, onMasks, films: false });
  state.roles.clear();
  state.look?.abort();
  $("#material-drop").replaceChildren(
    dropZone(take, { id: "material", text: t("material_drop"), hint: t("material_hint"), accept: ACCEPT, folders: true }),
  );
  $("#material-drop .row").append(h("button", { type: "button", id: "example", onclick: makeExample }, icon("play"), t("example")));
  $("#material-refused").replaceChildren();
  buildOptions($("#options"), lookSoon, () => state.films);
  $("#start").onclick = start;
  $("#repair").onclick = () => attempt(async () => state.onMasks((await post("/jobs/masks", request())).id));
  drawFiles();
  showEmpty();
  if (batch) resumeBatch(batch);
}

async function resumeBatch(batch) {
  try {
    await get(`/uploads/${batch}`);
    state.batch = batch;
    await look();
  } catch {
    history.replaceState(null, "", addressOf({})); // it was cleared away
  }
}

function useBatch(batch) {
  state.batch = batch;
  history.replaceState(null, "", addressOf({ batch }));
}

const take = (entries) =>
  attempt(async () => {
    const meter = h("progress", { max: String(entries.length), value: "0", "aria-label": t("uploading", { done: 0, total: entries.length }) });
    $("#material-refused").replaceChildren(meter);
    const came = await uploadAll(entries, { batch: state.batch, onProgress: (done) => (meter.value = done) }).finally(() => meter.remove());
    const refused = refusedList(came.refused);
    if (refused) $("#material-refused").append(refused);
    if (!came.batch) return;
    useBatch(came.batch);
    state.files = []; // what is new finds its part first
    await look();
  });

const makeExample = () =>
  attempt(async () => {
    const button = $("#example");
    button.disabled = true;
    showLooking(t("example_making"));
    try {
      const made = await post("/estimations/example");
      useBatch(made.batch);
      Object.assign(state, { files: [] });
      state.roles.clear();
      await look();
      $("#material-files").prepend(h("p", { class: "note" }, t("example_made")));
    } catch (error) {
      showEmpty();
      throw error;
    } finally {
      button.disabled = false;
    }
  });

function drawFiles() {
  const change = (name, role) => {
    state.roles.set(name, role);
    state.files = state.files.map((file) => (file.name === name ? { ...file, role } : file));
    buildRoleOptions();
    look();
  };
  const again = () => {
    history.replaceState(null, "", addressOf({}));
    showSetup({ batch: null, onJob: state.onJob, onMasks: state.onMasks });
    $("#material-drop button").focus();
  };
  showFiles($("#material-files"), state.files, { change, again });
}

const namesOf = (role) => state.files.filter((file) => file.role === role).map((file) => file.name);

function buildRoleOptions() {
  $("#options").dataset.start = namesOf("start").length ? "file" : "";
}

/** What is asked of the interface; before the files have parts, the studio finds them. */
function request() {
  const said = { batch: state.batch, ...readOptions($("#options")) };
  const { start_frame: frame, ...rest } = said;
  if (!state.files.length) return rest;
  const [cameras, body, first] = ["cameras", "body", "start"].map((role) => namesOf(role)[0] ?? null);
  return {
    ...rest,
    sources: namesOf("source"),
    backgrounds: namesOf("background"),
    cameras,
    body: body ? { file: body } : rest.body,
    start: first ? { motion: `file:${state.batch}/${first}`, frame } : null,
  };
}

async function look() {
  if (!state.batch) return;
  state.look?.abort();
  const mine = (state.look = new AbortController());
  showLooking();
  try {
    let found = await post("/estimations/preview", request(), mine.signal);
    if (state.look !== mine) return;
    state.files = found.files.map((file) => ({ ...file, role: state.roles.get(file.name) ?? file.role }));
    const differs = found.files.some((file) => state.roles.has(file.name) && state.roles.get(file.name) !== file.role);
    if (differs && !mine.explicit) found = await post("/estimations/preview", request(), mine.signal);
    if (state.look !== mine) return;
    buildRoleOptions();
    drawFiles();
    if (found.films && !state.films) $("#options").elements.overlay_video.checked = false; // the page itself shows them
    state.films = found.films;
    showPreview(found);
  } catch (error) {
    if (error.name === "AbortError") return;
    showPreview({ files: state.files, views: [], notes: [], missing: error.message });
  }
}

const lookSoon = later(look, 450);

const start = () =>
  attempt(async () => {
    $("#start").disabled = true;
    try {
      const job = await post("/jobs/estimate", { ...request(), overlay_video: $("#options").elements.overlay_video.checked });
      state.onJob(job.id);
    } finally {
      $("#start").disabled = false;
    }
  });
