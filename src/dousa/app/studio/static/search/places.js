// Where in takes something like the query happens.

import { baseName, h, t } from "../core/dom.js";

const CLEAR = 0.3; // score below which a place is shown only to who asks, where the library has not learned what is alike
const isClear = (place) => place.alike ?? place.score >= CLEAR;

/** "1:04.2" */
export function formatMoment(seconds) {
  const tenths = Math.round(10 * seconds);
  return `${Math.floor(tenths / 600)}:${String(Math.floor(tenths / 10) % 60).padStart(2, "0")}.${tenths % 10}`;
}

/** onChoose(place) shows it beside the query. */
export function drawPlaces(element, places, onChoose) {
  element.hidden = false;
  const clear = places.filter(isClear);
  const others = places.filter((place) => !isClear(place));
  const row = (place) => {
    const when = `${formatMoment(place.start_s)} – ${formatMoment(place.end_s)}`;
    return h(
      "li",
      { class: "place", dataset: { at: String(place.start_s) } },
      h("button", { type: "button", class: "place-open", onclick: () => onChoose(place) }, h("b", {}, when), h("span", { class: "hit-name" }, baseName(place.take)), h("span", { class: "note" }, `${t("score")} ${place.score.toFixed(2)}`), h("span", { class: "note" }, t("tempo", { value: place.tempo.toFixed(1) })), place.mirrored ? h("span", { class: "badge" }, "⇄ ", t("mirrored")) : null),
      h("a", { href: `/takes?motion=${place.motion}&at_s=${place.start_s.toFixed(2)}` }, t("open_take")),
    );
  };
  const list = (some) => h("ol", { class: "places" }, ...some.map(row));
  const rest = others.length ? h("details", {}, h("summary", {}, t("places_others", { count: others.length })), list(others)) : null;
  element.replaceChildren(h("h2", {}, t("places")), clear.length ? list(clear) : h("p", { class: "note" }, t("places_none")), ...[rest].filter(Boolean));
}
