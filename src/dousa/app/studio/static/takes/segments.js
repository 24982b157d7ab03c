// The stretches of a take as a table.

import { formatSeconds, h, icon, t } from "../core/dom.js";
import { kindOf, makeSwatch, nameOf, sayName } from "../core/timeline_parts.js";

function sayWhat(one) {
  const [kind, said] = [kindOf(one), sayName(kindOf(one), nameOf(one))];
  return kind === "unknown" || kind === "perhaps" ? h("i", {}, said) : said;
}

function confidence(one) {
  if (one.corrected) return h("span", {}, "✎ ", t("by_hand"));
  if (one.confidence == null) return t("given");
  const percent = Math.round(100 * one.confidence);
  return h("span", { class: "sure" }, h("span", { class: "track", "aria-hidden": "true" }, h("i", { style: { width: `${percent}%` } })), `${percent} %`);
}

/** How often it is done, where that is more than once. */
export function often(one) {
  return nameOf(one) && one.repetitions > 1 ? h("span", { class: "often" }, `× ${one.repetitions}`) : "";
}

/** tools: {motion, tones, onGo(segment), onChoose(segment), onExport(segment)} */
export function drawSegments(element, segments, { motion, tones, onGo, onChoose, onExport }) {
  const scrolled = element.querySelector(".scroll")?.scrollTop ?? 0;
  const row = (one) => {
    const asked = new URLSearchParams({ motion, start_s: one.start_s.toFixed(2), end_s: one.end_s.toFixed(2) });
    return h(
      "tr",
      { dataset: { start: String(one.start_s) } },
      h("td", {}, h("button", { type: "button", class: "small quiet go", onclick: () => onGo(one), ondblclick: () => onChoose(one) }, `${formatSeconds(one.start_s)} – ${formatSeconds(one.end_s)}`)),
      h("th", { scope: "row" }, h("span", { class: "what" }, makeSwatch(kindOf(one), nameOf(one), tones, { "aria-hidden": "true" }), sayWhat(one), often(one))),
      h("td", {}, confidence(one)),
      h("td", { class: "acts" }, h("button", { type: "button", class: "small quiet", onclick: () => onChoose(one), title: t("correct_title") }, icon("tag"), h("span", { class: "word" }, t("correct_title"))), h("a", { class: "button small quiet", href: `/search?${asked}`, title: t("search_segment") }, icon("search"), h("span", { class: "word" }, t("search_word"))), h("button", { type: "button", class: "small quiet export", onclick: () => onExport(one), title: t("export_part") }, icon("download"), h("span", { class: "word" }, t("export_word")))),
    );
  };
  const head = ["time", "what", "sure", "act"].map((name) => h("th", { scope: "col" }, name === "act" ? h("span", { class: "sr" }, t("column_act")) : t(`column_${name}`)));
  const table = h("table", {}, h("thead", {}, h("tr", {}, ...head)), h("tbody", {}, ...segments.map(row)));
  element.replaceChildren(h("h2", {}, t("segments")), segments.length ? h("div", { class: "scroll" }, table) : h("p", { class: "note" }, t("not_labelled")));
  if (segments.length) element.querySelector(".scroll").scrollTop = scrolled;
}

/** Which stretches are under the cursor: their places in the table. */
export function markSegments(element, places) {
  const rows = element.querySelectorAll("tbody tr");
  const now = places.map((place) => rows[place]).filter(Boolean);
  const before = [...element.querySelectorAll("tr[aria-current]")];
  if (before.length === now.length && now.every((row, number) => row === before[number])) return;
  for (const row of before) row.removeAttribute("aria-current");
  for (const row of now) row.setAttribute("aria-current", "true");
  if (!now.length) return;
  const [box, inside] = [element.querySelector(".scroll"), now[0].offsetTop];
  if (inside < box.scrollTop + 30 || inside > box.scrollTop + box.clientHeight - 40) box.scrollTop = inside - box.clientHeight / 3;
}
