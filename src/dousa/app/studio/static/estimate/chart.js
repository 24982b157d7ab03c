// A number of every frame as a curve, such as the overlap; lost frames are hatched, unsure ones shaded, and frames that
// may still change are dashed.

import { h, onDrag, t } from "../core/dom.js";

const SVG = "http://www.w3.org/2000/svg";
const [WIDE, HIGH] = [1000, 100];
const MOST_POINTS = 800; // of the curve; of more frames the worst of each column is drawn
let nCharts = 0;
const BAND = { good: 6, unsure: 10, lost: 14 }; // units high
const LEAST_LOST = 3; // units: one lost frame of a long recording still shows

function svg(tag, properties = {}, ...children) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(properties)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

export class Chart {
  /** onSeek(frame) when the curve is touched; worst: Math.min or Math.max, of frames that share a column. */
  constructor(place, onSeek, { labels = ["1", "0.5", "0"], worst = Math.min } = {}) {
    Object.assign(this, { total: 1, worst, hatch: `lost-hatch-${(nCharts += 1)}` });
    this.spans = svg("g");
    this.lines = svg("g");
    this.trust = svg("g");
    this.cursor = svg("line", { class: "cursor", y1: 0, y2: HIGH, x1: 0, x2: 0 });
    const grid = [0.25, 0.5, 0.75].map((value) => svg("line", { class: "grid", x1: 0, x2: WIDE, y1: HIGH * value, y2: HIGH * value }));
    this.drawing = svg("svg", { viewBox: `0 0 ${WIDE} ${HIGH}`, preserveAspectRatio: "none", "aria-hidden": "true" }, hatching(this.hatch), ...grid, this.spans, this.lines, this.trust, this.cursor);
    place.replaceChildren(...labels.map((text, index) => h("span", { class: "scale", style: { top: `${6 + 44 * index}%` }, "aria-hidden": "true" }, text)), this.drawing);
    onDrag(this.drawing, (x) => onSeek(Math.round(Math.min(Math.max(x, 0), 1) * (this.total - 1))));
  }

  column(frame) {
    return (WIDE * frame) / Math.max(this.total - 1, 1);
  }

  /** frames: Map frame -> {overlap (0 to 1, or null), lost, unsure, stage} */
  draw(frames, total) {
    this.total = Math.max(total, 1);
    const known = [...frames.keys()].sort((a, b) => a - b);
    this.lines.replaceChildren(...this.curves(known, frames));
    this.trust.replaceChildren(...this.bands(known, frames));
    this.spans.replaceChildren(...this.marked(known, frames, "unsure"), ...this.marked(known, frames, "lost"));
  }

  curves(known, frames) {
    const step = Math.max(1, Math.ceil(this.total / MOST_POINTS));
    const pieces = [];
    let piece = null;
    let last = null;
    for (const frame of thin(known, frames, step, this.worst)) {
      const { overlap, stage } = frames.get(frame);
      if (overlap === null) {
        piece = null;
        continue;
      }
      const open = stage === 0;
      const point = `${this.column(frame).toFixed(1)},${(HIGH * (1 - 0.94 * overlap - 0.03)).toFixed(1)}`;
      if (!piece || piece.open !== open || frame - last > 2 * step) {
        const joined = piece && frame - last <= 2 * step ? [piece.points.at(-1)] : [];
        pieces.push((piece = { open, points: joined }));
      }
      piece.points.push(point);
      last = frame;
    }
    return pieces.map(({ open, points }) => svg("polyline", { class: open ? "curve open" : "curve", points: (points.length > 1 ? points : [points[0], points[0]]).join(" ") }));
  }

  /** How far each frame is to be trusted, along the bottom: green, amber (thicker), red (thickest). */
  bands(known, frames) {
    const settled = known.filter((frame) => frames.get(frame).stage !== 0);
    const trustOf = ({ lost, unsure }) => (lost ? "lost" : unsure ? "unsure" : "good");
    return this.spansOf(settled, (frame) => trustOf(frames.get(frame))).map(({ kind, x, width }) => {
      const height = BAND[kind];
      return svg("rect", { class: `trust-band ${kind}`, x, y: HIGH - height, width: kind === "good" ? width : Math.max(width, LEAST_LOST), height });
    });
  }

  marked(known, frames, mark) {
    const spans = this.spansOf(known.filter((frame) => frames.get(frame)[mark]), () => mark);
    return spans.map(({ x, width }) => {
      const title = svg("title");
      title.textContent = t(`chart_${mark}`);
      const fill = mark === "lost" ? { fill: `url(#${this.hatch})` } : {};
      return svg("rect", { class: `${mark}-span`, x, y: 0, width: Math.max(width, LEAST_LOST), height: HIGH, ...fill }, title);
    });
  }

  /** Where frames of one kind follow each other without a gap. */
  spansOf(known, kindOf) {
    const spans = [];
    for (const frame of known) {
      const [newest, kind] = [spans.at(-1), kindOf(frame)];
      if (newest?.kind === kind && newest.last === frame - 1) newest.last = frame;
      else spans.push({ kind, first: frame, last: frame });
    }
    return spans.map(({ kind, first, last }) => ({ kind, x: this.column(first - 0.5), width: this.column(last + 0.5) - this.column(first - 0.5) }));
  }

  point(frame) {
    for (const end of ["x1", "x2"]) this.cursor.setAttribute(end, this.column(frame).toFixed(2));
  }
}

function thin(known, frames, step, worst) {
  if (step === 1) return known;
  const chosen = new Map();
  for (const frame of known) {
    const column = Math.floor(frame / step);
    const best = chosen.get(column);
    const value = frames.get(frame).overlap;
    const least = best === undefined ? null : frames.get(best).overlap;
    if (best === undefined || least === null || (value !== null && value !== least && worst(value, least) === value)) chosen.set(column, frame);
  }
  return [...chosen.values()];
}

function hatching(id) {
  const pattern = svg(
    "pattern",
    { id, width: 8, height: 8, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" },
    svg("rect", { class: "hatch-back", width: 8, height: 8 }),
    svg("line", { class: "hatch-line", x1: 0, y1: 0, x2: 0, y2: 8 }),
  );
  return svg("defs", {}, pattern);
}
