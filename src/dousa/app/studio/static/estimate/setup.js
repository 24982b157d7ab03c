// Before an estimation: files find their parts, a person is described, the first silhouettes are looked at.

import { get, post, uploadAll } from "../core/api.js";
import { $, baseName, formatSeconds, h, icon, later, t } from "../core/dom.js";
import { dropZone, refusedList } from "../core/drop.js";
import { attempt } from "../core/notices.js";

// Who moves, and how it is searched: fields, and what they say to the interface.
const SEEN = new Set(["frames", "rate", "size", "kind", "background_method", "mirrored", "cues", "model"]); // what a look would show
const SEEN_OF_FILMS = new Set(["stature"]);

const number = (name, least, most, step, hint) =>
  field(name, h("input", { type: "number", name, min: String(least), max: String(most), step: String(step), placeholder: t(hint), inputmode: "decimal" }));
const field = (name, control) => h("label", { class: "field" }, t(name), control);
const choice = (name, values) => field(name, h("select", { name }, ...values.map(([value, word]) => h("option", { value }, t(word)))));
const check = (name, checked) => h("label", { class: "check" }, h("input", { type: "checkbox", name, checked }), t(name));

/** Fill the form; onChange() after a change that a look would show, of films if isFilms(). */
function buildOptions(form, onChange, isFilms) {
  form.replaceChildren(
    h(
      "div",
      { class: "fields" },
      number("stature", 20, 300, "any", "stature_hint"),
      choice("sex", [["average", "sex_average"], ["female", "sex_female"], ["male", "sex_male"]]),
    ),
    h("details", {}, h("summary", {}, t("options_title")), h("div", { class: "fields" }, ...more())),
  );
  form.onsubmit = (event) => event.preventDefault();
  form.oninput = (event) => (SEEN.has(event.target.name) || (SEEN_OF_FILMS.has(event.target.name) && isFilms())) && onChange();
}

function more() {
  return [
    choice("cues", [["", "cues_auto"], ["both", "cues_both"], ["keypoints", "cues_keypoints"], ["silhouettes", "cues_silhouettes"]]),
    choice("model", [["", "model_auto"], ["heavy", "model_heavy"], ["full", "model_full"], ["lite", "model_lite"]]),
    choice("offsets", [["auto", "offsets_auto"], ["none", "offsets_none"]]),
    field("frames", h("input", { type: "text", name: "frames", placeholder: t("frames_hint"), pattern: "-?\\d*:-?\\d*" })),
    number("rate", 0.1, 10000, "any", "rate_hint"),
    field("size", h("input", { type: "text", name: "size", placeholder: t("size_hint"), pattern: "\\d+x\\d+" })),
    choice("kind", [["", "kind_auto"], ["mask", "kind_is_mask"], ["video", "kind_is_video"]]),
    choice("background_method", [["", "background_auto"], ["plate", "background_plate"], ["median", "background_median"], ["mog2", "background_mog2"]]),
    choice("bones", [["auto", "bones_auto"], ["tables", "bones_tables"], ["start", "bones_start"]]),
    field("start_frame", h("input", { type: "number", name: "start_frame", min: "0", step: "1", placeholder: "0" })),
    choice("method", [["default", "method_default"], ["paper", "method_paper"]]),
    number("smoothing", 0, 1000, "any", "smoothing_hint"),
    number("beam", 1, 64, 1, "beam_hint"),
    check("mirrored", false),
    check("overlay_video", true),
  ];
}

const numberOf = (input) => (input.value === "" || !Number.isFinite(input.valueAsNumber) ? null : input.valueAsNumber);

/** The fields as POST /jobs/estimate wants them, and the frame of the first pose. */
function readOptions(form) {
  const at = form.elements;
  const stature = numberOf(at.stature);
  const frames = at.frames.value.trim();
  return {
    body: { stature_m: stature === null ? null : stature / 100, sex: at.sex.value },
    frames: frames && !frames.includes(":") ? `${frames}:` : frames || null,
    rate: numberOf(at.rate),
    size: at.size.value.trim() || null,
    cues: at.cues.value || null,
    model: at.model.value || null,
    offsets: at.offsets.value,
    kind: at.kind.value || null,
    background_method: at.background_method.value || null,
    bones: at.bones.value,
    method: at.method.value,
    smoothing: numberOf(at.smoothing),
    beam: numberOf(at.beam),
    mirrored: at.mirrored.checked,
    start_frame: Math.max(Math.round(numberOf(at.start_frame) ?? 0), 0),
  };
}

// What would be estimated: silhouettes, cameras, body, and what is missing.
function showEmpty() {
  $("#start").disabled = true;
  $("#repair").hidden = true;
  $("#preview").replaceChildren(h("p", { class: "note" }, t("preview_empty")));
}

function showLooking(what = t("preview_looking")) {
  $("#start").disabled = true;
  $("#preview .looking")?.remove();
  $("#preview").prepend(h("p", { class: "looking" }, h("i", { "aria-hidden": "true" }), what));
}

function showPreview(found) {
  const ready = !found.missing && found.views.length > 0;
  $("#start").disabled = !ready;
  $("#repair").hidden = found.films || !found.views.length; // of films people are found, not silhouettes
  $("#preview").replaceChildren(
    ...[
      found.missing ? h("p", { class: "problem-box", id: "missing" }, found.missing) : null,
      found.views.length ? h("div", { class: "pictures" }, ...found.views.map((view) => picture(view, found.films))) : null,
      found.views.length ? facts(found) : null,
      found.notes.length ? h("ul", { class: "says" }, ...found.notes.map((note) => h("li", {}, note))) : null,
    ].filter(Boolean),
  );
}

function picture(view, films) {
  const inside = view.picture
    ? h("img", { src: view.picture, alt: t(films ? "preview_film" : "preview_picture", { name: view.name }) })
    : t(films ? "preview_no_film" : "preview_no_picture");
  return h(
    "figure",
    {},
    h("div", { class: "frame" }, inside),
    h("figcaption", {}, h("b", {}, view.name), h("span", { class: "note" }, view.camera ? t("preview_camera", { name: view.camera }) : t(films ? "preview_camera_found" : "preview_no_camera"))),
  );
}

function facts(found) {
  const seconds = found.frame_rate ? formatSeconds(found.n_frames / found.frame_rate) : "";
  const rate = found.frame_rate ? +found.frame_rate.toFixed(2) : "?";
  const pairs = found.body ? [[t("preview_body"), found.body], [t("preview_start"), found.start ?? t("preview_start_found")]] : [];
  return h(
    "div",
    { class: "stack" },
    h("p", { class: "counted" }, t(found.films ? "preview_film_facts" : "preview_facts", { views: found.views.length, frames: found.n_frames, rate, seconds })),
    pairs.length ? h("dl", { class: "facts" }, ...pairs.flatMap(([name, value]) => [h("dt", {}, name), h("dd", {}, value)])) : null,
  );
}

// The table of uploaded files and what each is used as.
const ROLES = ["source", "cameras", "background", "body", "start", "unused"];

/** files: [{name, role, kind, n_files}]; on: {change(name, role), again()} */
function showFiles(place, files, on) {
  const focused = place.contains(document.activeElement) ? document.activeElement.dataset.name : null;
  if (!files.length) {
    place.replaceChildren();
    return;
  }
  place.replaceChildren(
    h(
      "table",
      { class: "files" },
      h("thead", {}, h("tr", {}, h("th", { scope: "col" }, t("files_name")), h("th", { scope: "col" }, t("files_role")))),
      h("tbody", {}, ...files.map((file) => row(file, on.change))),
    ),
    h("div", { class: "files-foot" }, h("span"), h("button", { type: "button", class: "small quiet", onclick: on.again }, t("files_again"))),
  );
  if (focused) [...place.querySelectorAll("select")].find((select) => select.dataset.name === focused)?.focus();
}

function row(file, change) {
  const shown = file.name === "." ? "/" : baseName(file.name);
  const select = h(
    "select",
    { "aria-label": t("files_role_of", { name: shown }), dataset: { name: file.name }, onchange: () => change(file.name, select.value) },
    ...ROLES.map((role) => h("option", { value: role, selected: role === file.role }, t(`role_${role}`))),
  );
  const kind = t(`kind_${file.kind}`, { count: file.n_files });
  return h("tr", {}, h("th", { scope: "row" }, shown, kind ? h("span", { class: "note" }, kind) : null), h("td", {}, select));
}

// Addresses of this page: what is shown stands in them, so that a reload shows it again.
export function addressOf(params) {
  const query = new URLSearchParams(params);
  const language = new URLSearchParams(location.search).get("lang");
  if (language) query.set("lang", language);
  const text = query.toString();
  return text ? `/estimate?${text}` : "/estimate";
}

const ACCEPT = ".npz,.zip,.mp4,.avi,.mov,.mkv,.webm,.m4v,.png,.jpg,.jpeg,.bmp,.tif,.tiff,.toml,.xml,.yaml,.yml,.json,.csv,.tsv,.txt,.xcp,.calib,.pickle,.bvh,.amc,.asf,.c3d,.trc";

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
