// The takes of the library, each with its labels in a strip.

import { get } from "../core/api.js";
import { baseName, formatSeconds, h, t } from "../core/dom.js";
import { notify } from "../core/notices.js";
import { Tones, drawStrip, sayShares, toSegment } from "../core/timeline_parts.js";

function say(labels, duration) {
  if (!labels?.segments) return t("not_labelled");
  return t(labels.given ? "strip_given" : "strip_facts", { count: labels.segments.length, unknown: sayShares(labels.segments, duration) });
}

/** A list of rows that lead to their takes; the strips come when they are known. */
export function listTakes(items) {
  const tones = new Tones(); // one for all: a category has one colour in the whole list
  const rows = items.map((clip) => {
    const strip = h("div", { class: "take-strip", "aria-hidden": "true" });
    const facts = h("span", { class: "note" });
    const top = h("span", { class: "take-top" }, h("b", {}, baseName(clip.path)), facts, h("span", { class: "note" }, clip.performer ?? ""), h("span", { class: "note" }, formatSeconds(clip.duration)));
    return { clip, strip, facts, element: h("li", {}, h("a", { class: "take-row", href: `/takes?motion=clip:${clip.id}` }, top, strip)) };
  });
  const asked = new URLSearchParams(items.map((clip) => ["motion", `clip:${clip.id}`]));
  if (items.length)
    get(`/takes/strips?${asked}`).then(({ takes }) => {
      for (const { clip, strip, facts } of rows) {
        const labels = takes[`clip:${clip.id}`];
        facts.textContent = say(labels, clip.duration);
        drawStrip(strip, (labels?.segments ?? []).map(toSegment), clip.duration, tones);
      }
    }, (error) => notify(error.message, "problem"));
  return h("ul", { class: "take-list" }, ...rows.map((row) => row.element));
}
