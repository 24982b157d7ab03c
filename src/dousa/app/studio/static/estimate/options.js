// Who moves, and how it is searched: fields, and what they say to the interface.

import { h, t } from "../core/dom.js";

const SEEN = new Set(["frames", "rate", "kind", "background_method", "mirrored", "cues", "model"]); // what a look would show
const SEEN_OF_FILMS = new Set(["stature"]);

const number = (name, least, most, step, hint) =>
  field(name, h("input", { type: "number", name, min: String(least), max: String(most), step: String(step), placeholder: t(hint), inputmode: "decimal" }));
const field = (name, control) => h("label", { class: "field" }, t(name), control);
const choice = (name, values) => field(name, h("select", { name }, ...values.map(([value, word]) => h("option", { value }, t(word)))));
const check = (name, checked) => h("label", { class: "check" }, h("input", { type: "checkbox", name, checked }), t(name));

/** Fill the form; onChange() after a change that a look would show, of films if isFilms(). */
export function buildOptions(form, onChange, isFilms) {
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
    choice("cues", [["", "cues_auto"], ["keypoints", "cues_keypoints"], ["silhouettes", "cues_silhouettes"]]),
    choice("model", [["", "model_auto"], ["heavy", "model_heavy"], ["full", "model_full"], ["lite", "model_lite"]]),
    choice("offsets", [["auto", "offsets_auto"], ["none", "offsets_none"]]),
    field("frames", h("input", { type: "text", name: "frames", placeholder: t("frames_hint"), pattern: "-?\\d*:-?\\d*" })),
    number("rate", 0.1, 10000, "any", "rate_hint"),
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
export function readOptions(form) {
  const at = form.elements;
  const stature = numberOf(at.stature);
  const frames = at.frames.value.trim();
  return {
    body: { stature_m: stature === null ? null : stature / 100, sex: at.sex.value },
    frames: frames && !frames.includes(":") ? `${frames}:` : frames || null,
    rate: numberOf(at.rate),
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
