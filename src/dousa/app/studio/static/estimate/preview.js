// What would be estimated: silhouettes, cameras, body, and what is missing.

import { $, formatSeconds, h, t } from "../core/dom.js";

export function showEmpty() {
  $("#start").disabled = true;
  $("#repair").hidden = true;
  $("#preview").replaceChildren(h("p", { class: "note" }, t("preview_empty")));
}

export function showLooking(what = t("preview_looking")) {
  $("#start").disabled = true;
  $("#preview .looking")?.remove();
  $("#preview").prepend(h("p", { class: "looking" }, h("i", { "aria-hidden": "true" }), what));
}

/** found: the answer of POST /estimations/preview */
export function showPreview(found) {
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
