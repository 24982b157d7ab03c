// All frames of the silhouettes, a line for each view: which look doubtful, which were repaired, where we are.

import { h } from "../core/dom.js";

const HIGH = 12; // px of a line

export class Strip {
  /** onSeek(view, frame) */
  constructor(onSeek) {
    this.probe = h("span", { class: "masks-colours", hidden: true, "aria-hidden": "true" }, ...["doubt", "repaired", "ink", "line"].map((name) => h("i", { class: name })));
    this.canvas = h("canvas", { class: "masks-strip", "aria-hidden": "true" });
    this.element = h("div", {}, this.canvas, this.probe);
    Object.assign(this, { frames: 1, rows: [], view: 0, frame: 0 });
    const seek = (event) => {
      const box = this.canvas.getBoundingClientRect();
      const row = Math.floor(((event.clientY - box.top) / box.height) * this.rows.length);
      const frame = Math.floor(((event.clientX - box.left) / box.width) * this.frames);
      onSeek(Math.min(Math.max(row, 0), this.rows.length - 1), Math.min(Math.max(frame, 0), this.frames - 1));
    };
    this.canvas.addEventListener("pointerdown", seek);
    this.canvas.addEventListener("pointermove", (event) => event.buttons && seek(event));
    new ResizeObserver(() => this.draw()).observe(this.canvas);
    new MutationObserver(() => this.draw()).observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });
  }

  /** rows: by view {doubts: [frame], repaired: [frame]} */
  set(frames, rows) {
    Object.assign(this, { frames, rows });
    this.canvas.style.height = `${HIGH * rows.length}px`;
    this.draw();
  }

  point(view, frame) {
    Object.assign(this, { view, frame });
    this.draw();
  }

  draw() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [Math.round(this.canvas.clientWidth * ratio), Math.round(HIGH * this.rows.length * ratio)];
    if (!width || !height) return;
    Object.assign(this.canvas, { width, height });
    this.probe.hidden = false;
    const [doubt, repaired, ink, line] = [...this.probe.children].map((one) => getComputedStyle(one).color);
    this.probe.hidden = true;
    const context = this.canvas.getContext("2d");
    const one = width / this.frames;
    const bar = (style, row, frame, from, high) => {
      context.fillStyle = style;
      context.fillRect(frame * one, (row + from) * HIGH * ratio, Math.max(one, 2 * ratio), high * HIGH * ratio);
    };
    for (const [row, { doubts, repaired: touched }] of this.rows.entries()) {
      context.fillStyle = line;
      context.fillRect(0, (row + 0.45) * HIGH * ratio, width, ratio);
      for (const frame of doubts) bar(doubt, row, frame, 0.1, 0.8);
      for (const frame of touched) bar(repaired, row, frame, 0.3, 0.4);
    }
    context.fillStyle = ink;
    context.fillRect(this.frame * one + one / 2 - ratio, 0, 2 * ratio, height);
    context.fillRect(Math.max(this.frame * one - 3 * ratio, 0), this.view * HIGH * ratio, one + 6 * ratio, 2 * ratio);
  }
}
