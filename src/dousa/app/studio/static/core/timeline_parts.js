// What a timeline is drawn of: the ruler, stretches with their letters, the legend. Elements, so that text stays text.

import { formatSeconds, h, t } from "./dom.js";

const HUES = [255, 55, 160, 325, 95, 205, 20, 290, 130, 235, 75, 350];
const STEPS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1800, 3600];
const ROOM = 64; // px that a label of the ruler needs

/** Letters and colours of categories; what was seen once keeps its own. */
export class Tones {
  constructor() {
    this.known = new Map();
  }

  of(label) {
    if (!this.known.has(label)) this.known.set(label, this.known.size);
    const place = this.known.get(label);
    const round = Math.floor(place / 26);
    return {
      letter: String.fromCharCode(65 + (place % 26)) + (round ? round : ""),
      hue: HUES[place % HUES.length],
      pattern: Math.floor(place / HUES.length) % 3,
    };
  }
}

const percent = (part, whole) => `${(100 * part) / Math.max(whole, 1e-9)}%`;

/** Where something from start to end lies: a style. */
export const place = (start, end, duration) => ({ left: percent(start, duration), width: percent(end - start, duration) });

/** "kick, 93 %, 1.2 s to 3.4 s" */
export function describeSegment(segment) {
  const what = segment.kind === "unknown" ? t("unknown") : segment.label;
  const sure = segment.kind === "known" && segment.confidence != null ? `${Math.round(100 * segment.confidence)} %` : null;
  const hand = segment.kind === "corrected" ? t("timeline_corrected") : null;
  const when = t("timeline_span", { start: formatSeconds(segment.start), end: formatSeconds(segment.end) });
  return [what, sure, hand, when].filter(Boolean).join(", ");
}

export function makeSegment(segment, duration, tones) {
  const unknown = segment.kind === "unknown";
  const tone = unknown ? null : tones.of(segment.label);
  const element = h(
    "div",
    { class: `tl-segment tl-${segment.kind}${tone ? ` tl-pattern-${tone.pattern}` : ""}`, title: describeSegment(segment), style: place(segment.start, segment.end, duration) },
    h("b", {}, unknown ? "?" : tone.letter),
    h("span", {}, unknown ? t("unknown") : segment.label),
  );
  if (tone) element.style.setProperty("--hue", tone.hue);
  if (segment.kind === "corrected") element.append(h("i", {}, "✎"));
  else if (segment.confidence != null) element.append(h("u", { class: "tl-sure", style: { width: percent(segment.confidence, 1) } }));
  return element;
}

/** Stretches in little, without words. */
export function drawStrip(element, segments, duration, tones) {
  const piece = (one) => {
    const unknown = one.kind === "unknown";
    const part = h("i", { class: unknown ? "tl-none" : "", style: place(one.start, one.end, duration) });
    if (!unknown) part.style.setProperty("--hue", tones.of(one.label).hue);
    return part;
  };
  element.classList.add("tl-little");
  element.replaceChildren(...segments.map(piece));
}

/** What the letters and patterns mean: [{label, kind}] in any order. */
export function makeLegend(segments, tones) {
  const labels = [...new Set(segments.filter((one) => one.kind !== "unknown").map((one) => one.label))];
  const item = (swatch, text) => h("li", {}, swatch, text);
  const items = labels.map((label) => {
    const tone = tones.of(label);
    const swatch = h("b", { class: `tl-swatch tl-pattern-${tone.pattern}` }, tone.letter);
    swatch.style.setProperty("--hue", tone.hue);
    return item(swatch, label);
  });
  if (segments.some((one) => one.kind === "unknown")) items.push(item(h("b", { class: "tl-swatch tl-unknown" }, "?"), t("unknown")));
  if (segments.some((one) => one.kind === "corrected")) items.push(item(h("b", { class: "tl-swatch tl-plain" }, "✎"), t("timeline_corrected")));
  return h("ul", { class: "tl-legend", "aria-label": t("timeline_legend") }, ...items);
}

function formatTick(seconds, step) {
  if (seconds < 60 && step < 60) return `${Number(seconds.toFixed(1))}`;
  const [minutes, rest] = [Math.floor(seconds / 60), Math.round(seconds % 60)];
  return `${minutes}:${String(rest).padStart(2, "0")}`;
}

/** Ticks of a ruler that is so many pixels wide. */
export function makeTicks(duration, width) {
  const step = STEPS.find((one) => (one / duration) * width >= ROOM) ?? STEPS.at(-1);
  const ticks = [];
  for (let k = 0; k * step <= duration + 1e-9; k += 1) {
    const seconds = k * step;
    const last = ((duration - seconds) / duration) * width < 20;
    ticks.push(h("span", { class: last ? "tl-tick tl-last" : "tl-tick", style: { left: percent(seconds, duration) } }, formatTick(seconds, step)));
  }
  return ticks;
}
