// What a timeline is drawn of: the ruler, stretches with their letters, the legend. Elements, so that text stays text.

import { formatSeconds, h, t } from "./dom.js";

const HUES = [255, 55, 160, 325, 95, 205, 20, 290, 130, 235, 75, 350];
const STEPS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1800, 3600];
const ROOM = 64; // px that a label of the ruler needs
const LABEL = 44; // px of a long one: nearer to the end it stands before its tick, as it would be scrolled to

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

export const place = (start, end, duration) => ({ left: percent(start, duration), width: percent(end - start, duration) });

const TOUCHING = 0.005; // s that neighbours may overlap by: times are rounded

/** Where segments lie that share a time: {lane, lanes} of each, lanes being as many as any of those it hangs together with. */
export function findLanes(segments) {
  const found = segments.map(() => ({ lane: 0, lanes: 1 }));
  const order = segments.map((_, number) => number).sort((a, b) => segments[a].start - segments[b].start || segments[a].end - segments[b].end);
  let [ends, group, last] = [[], [], -Infinity]; // of the lanes, and who hangs together, until when
  for (const number of order) {
    const { start, end } = segments[number];
    if (start >= last - TOUCHING) [ends, group] = [[], []];
    const free = ends.findIndex((one) => start >= one - TOUCHING);
    const lane = free < 0 ? ends.length : free;
    ends[lane] = end;
    group.push(number);
    found[number].lane = lane;
    for (const other of group) found[other].lanes = ends.length;
    last = Math.max(last, end);
  }
  return found;
}

const placeLane = ({ lane, lanes }) => (lanes === 1 ? {} : { top: percent(lane, lanes), bottom: percent(lanes - lane - 1, lanes) });

/** What a stretch of the API is for a timeline: how it is drawn, and under which name. */
export function kindOf(one) {
  if (one.corrected) return "corrected";
  if (one.perhaps) return "perhaps";
  return one.unknown ? "unknown" : "known";
}

export const nameOf = (one) => one.category ?? (one.perhaps ? one.guess : null);

export const toSegment = (one) => ({ start: one.start_s, end: one.end_s, label: nameOf(one), kind: kindOf(one), confidence: one.confidence });

/** "12 % unknown, 30 % doubtful" */
export function sayShares(stretches, duration) {
  const share = (kind) => stretches.reduce((sum, one) => sum + (kindOf(one) === kind ? one.end_s - one.start_s : 0), 0) / Math.max(duration, 1e-9);
  const [unknown, doubtful] = ["unknown", "perhaps"].map((kind) => Math.round(100 * share(kind)));
  return t("unknown_share", { percent: unknown }) + (doubtful ? `, ${t("doubtful_share", { percent: doubtful })}` : "");
}

export function sayName(kind, label) {
  if (kind === "unknown") return t("unknown");
  return kind === "perhaps" ? t("perhaps", { category: label }) : label;
}

/** "kick, 93 %, 1.2 s to 3.4 s" */
export function describeSegment(segment) {
  const what = sayName(segment.kind, segment.label);
  const sure = ["known", "perhaps"].includes(segment.kind) && segment.confidence != null ? `${Math.round(100 * segment.confidence)} %` : null;
  const hand = segment.kind === "corrected" ? t("timeline_corrected") : null;
  const when = t("timeline_span", { start: formatSeconds(segment.start), end: formatSeconds(segment.end) });
  return [what, sure, hand, when].filter(Boolean).join(", ");
}

const letterOf = (kind, tone) => (tone ? tone.letter : "") + (kind === "unknown" || kind === "perhaps" ? "?" : "");

/** The letter of a stretch in its pattern, as in the legend. */
export function makeSwatch(kind, label, tones, options = {}) {
  const tone = kind === "unknown" ? null : tones.of(label);
  const look = kind === "unknown" || kind === "perhaps" ? `tl-${kind}` : `tl-pattern-${tone.pattern}`;
  const swatch = h("b", { class: `tl-swatch ${look}`, ...options }, letterOf(kind, tone));
  if (tone) swatch.style.setProperty("--hue", tone.hue);
  return swatch;
}

export function makeSegment(segment, duration, tones, lane) {
  const unknown = segment.kind === "unknown";
  const tone = unknown ? null : tones.of(segment.label);
  const element = h(
    "div",
    { class: `tl-segment tl-${segment.kind}${tone && segment.kind !== "perhaps" ? ` tl-pattern-${tone.pattern}` : ""}`, title: describeSegment(segment), style: { ...place(segment.start, segment.end, duration), ...placeLane(lane) } },
    h("b", {}, letterOf(segment.kind, tone)),
    h("span", {}, sayName(segment.kind, segment.label)),
  );
  if (tone) element.style.setProperty("--hue", tone.hue);
  if (segment.kind === "corrected") element.append(h("i", {}, "✎"));
  else if (segment.confidence != null) element.append(h("u", { class: "tl-sure", style: { width: percent(segment.confidence, 1) } }));
  return element;
}

export function drawStrip(element, segments, duration, tones) {
  const lanes = findLanes(segments);
  const piece = (one, number) => {
    const unknown = one.kind === "unknown";
    const look = { unknown: "tl-none", perhaps: "tl-maybe" }[one.kind] ?? "";
    const part = h("i", { class: look, style: { ...place(one.start, one.end, duration), ...placeLane(lanes[number]) } });
    if (!unknown) part.style.setProperty("--hue", tones.of(one.label).hue);
    return part;
  };
  element.classList.add("tl-little");
  element.replaceChildren(...segments.map(piece));
}

/** What the letters and patterns mean: [{label, kind}] in any order. */
export function makeLegend(segments, tones) {
  const labelsOf = (isIn) => [...new Set(segments.filter((one) => isIn(one.kind)).map((one) => one.label))];
  const item = (swatch, text) => h("li", {}, swatch, text);
  const items = labelsOf((kind) => kind === "known" || kind === "corrected").map((label) => item(makeSwatch("known", label, tones), label));
  items.push(...labelsOf((kind) => kind === "perhaps").map((label) => item(makeSwatch("perhaps", label, tones), sayName("perhaps", label))));
  if (segments.some((one) => one.kind === "unknown")) items.push(item(makeSwatch("unknown", null, tones), t("unknown")));
  if (segments.some((one) => one.kind === "corrected")) items.push(item(h("b", { class: "tl-swatch tl-plain" }, "✎"), t("timeline_corrected")));
  return h("ul", { class: "tl-legend", "aria-label": t("timeline_legend") }, ...items);
}

function formatTick(seconds, step) {
  if (seconds < 60 && step < 60) return `${Number(seconds.toFixed(1))}`;
  const [minutes, rest] = [Math.floor(seconds / 60), Math.round(seconds % 60)];
  return `${minutes}:${String(rest).padStart(2, "0")}`;
}

export function makeTicks(duration, width) {
  const step = STEPS.find((one) => (one / duration) * width >= ROOM) ?? STEPS.at(-1);
  const ticks = [];
  for (let k = 0; k * step <= duration + 1e-9; k += 1) {
    const seconds = k * step;
    const last = ((duration - seconds) / duration) * width < LABEL;
    ticks.push(h("span", { class: last ? "tl-tick tl-last" : "tl-tick", style: { left: percent(seconds, duration) } }, formatTick(seconds, step)));
  }
  return ticks;
}
