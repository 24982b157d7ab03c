// One silhouette, large: the picture, the silhouette over it, and the brush. Strokes show at once; the studio's own
// answer follows.

import { h, onDrag } from "../core/dom.js";
import { onTheme } from "../core/theme.js";

// All frames of the silhouettes, a line for each view: which look doubtful, which were repaired, where we are.
const HIGH = 12; // px of a line

export class Strip {
  constructor(onSeek) {
    this.probe = h("span", { class: "masks-colours", hidden: true, "aria-hidden": "true" }, ...["doubt", "repaired", "ink", "line"].map((name) => h("i", { class: name })));
    this.canvas = h("canvas", { class: "masks-strip", "aria-hidden": "true" });
    this.element = h("div", {}, this.canvas, this.probe);
    Object.assign(this, { frames: 1, rows: [], view: 0, frame: 0 });
    const inside = (share, count) => Math.min(Math.max(Math.floor(share * count), 0), count - 1);
    onDrag(this.canvas, (x, y) => onSeek(inside(y, this.rows.length), inside(x, this.frames)));
    this.watching = new ResizeObserver(() => this.draw());
    this.watching.observe(this.canvas);
    this.endTheme = onTheme(() => this.draw());
  }

  destroy() {
    this.watching.disconnect();
    this.endTheme();
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

const TINT = { plain: [59, 82, 139], over: [255, 138, 30] }; // red, green, blue: on paper, over a picture
const PAPER = 240; // grey behind a silhouette without a picture

export class Sheet {
  /** on: {stroke({adds, points, radius}), click(point)}; tool() -> "add", "remove", "exclude", "exclude_through" */
  constructor(on, tool) {
    Object.assign(this, { on, tool, radius: 8, zoom: 1, size: [4, 3], points: null, ready: false });
    this.image = h("img", { alt: "", hidden: true, draggable: false });
    this.canvas = h("canvas", { class: "masks-canvas", role: "img" });
    this.ring = h("i", { class: "masks-ring", hidden: true, "aria-hidden": "true" });
    this.element = h("div", { class: "masks-sheet" }, this.image, this.canvas, this.ring);
    this.stage = h("div", { class: "masks-stage", tabindex: "0", role: "group" }, this.element);
    this.bits = document.createElement("canvas"); // white where the person is
    this.listen();
  }

  listen() {
    const { canvas } = this;
    canvas.addEventListener("pointerdown", (event) => event.button === 0 && this.begin(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => this.end());
    canvas.addEventListener("pointerleave", () => (this.ring.hidden = true));
  }

  setSize(width, height) {
    this.size = [width, height];
    for (const one of [this.canvas, this.bits]) Object.assign(one, { width, height });
    this.stage.style.setProperty("--ratio", String(width / height));
    this.ready = false;
  }

  setZoom(zoom) {
    this.zoom = Math.min(Math.max(zoom, 1), 6);
    this.element.style.width = `${100 * this.zoom}%`;
  }

  /** mask: decoded image, or null where there is none; picture: address, or null. */
  show(mask, picture, label) {
    const context = this.bits.getContext("2d", { willReadFrequently: true });
    context.clearRect(0, 0, ...this.size);
    if (mask) context.drawImage(mask, 0, 0);
    this.keepWhite(context);
    this.ready = Boolean(mask);
    this.canvas.setAttribute("aria-label", label);
    this.image.hidden = !picture;
    if (picture && this.image.src !== picture) this.image.src = picture;
    this.draw();
  }

  /** Black becomes see-through, so that strokes and silhouette are one. */
  keepWhite(context) {
    const data = context.getImageData(0, 0, ...this.size);
    for (let at = 0; at < data.data.length; at += 4) data.data[at + 3] = data.data[at] > 127 ? 255 : 0;
    context.putImageData(data, 0, 0);
  }

  draw() {
    const [width, height] = this.size;
    const inside = this.bits.getContext("2d", { willReadFrequently: true }).getImageData(0, 0, width, height).data;
    const context = this.canvas.getContext("2d");
    const drawn = context.createImageData(width, height);
    const bare = this.image.hidden;
    const [r, g, b] = bare ? TINT.plain : TINT.over;
    const pixels = new Uint32Array(drawn.data.buffer); // alpha, blue, green, red
    const shade = (alpha) => ((alpha << 24) | (b << 16) | (g << 8) | r) >>> 0;
    const [whole, thin, paper] = [shade(255), shade(bare ? 255 : 110), bare ? 0xff000000 + PAPER * 0x10101 : 0];
    const is = (at) => inside[4 * at + 3] > 127;
    for (let at = 0, x = 0; at < pixels.length; at += 1, x = x + 1 === width ? 0 : x + 1) {
      if (!is(at)) {
        pixels[at] = paper;
        continue;
      }
      const edge = x === 0 || x === width - 1 || at < width || at >= width * (height - 1) || !is(at - 1) || !is(at + 1) || !is(at - width) || !is(at + width);
      pixels[at] = edge ? whole : thin;
    }
    context.putImageData(drawn, 0, 0);
  }

  place(event) {
    const box = this.canvas.getBoundingClientRect();
    return [((event.clientX - box.left) / box.width) * this.size[0] - 0.5, ((event.clientY - box.top) / box.height) * this.size[1] - 0.5].map((value) => Math.round(value * 10) / 10);
  }

  begin(event) {
    if (!this.ready) return;
    event.preventDefault();
    this.stage.focus({ preventScroll: true });
    const tool = this.tool();
    if (tool.startsWith("exclude")) {
      this.on.click(this.place(event));
      return;
    }
    this.canvas.setPointerCapture?.(event.pointerId);
    this.adds = (tool === "add") !== event.altKey;
    this.points = [this.place(event)];
    this.paint();
  }

  move(event) {
    this.showRing(event);
    if (!this.points) return;
    const point = this.place(event);
    const last = this.points.at(-1);
    if (Math.hypot(point[0] - last[0], point[1] - last[1]) < Math.max(1, this.radius / 4)) return;
    this.points.push(point);
    this.paint();
  }

  end() {
    if (!this.points) return;
    const { points, radius, adds } = this;
    this.points = null;
    this.on.stroke({ points, radius, adds });
  }

  paint() {
    const context = this.bits.getContext("2d", { willReadFrequently: true });
    Object.assign(context, { globalCompositeOperation: this.adds ? "source-over" : "destination-out", strokeStyle: "#fff", lineWidth: 2 * this.radius, lineCap: "round", lineJoin: "round" });
    context.beginPath();
    for (const [x, y] of this.points.slice(-2)) context.lineTo(x + 0.5, y + 0.5);
    if (this.points.length === 1) context.lineTo(this.points[0][0] + 0.51, this.points[0][1] + 0.5);
    context.stroke();
    context.globalCompositeOperation = "source-over";
    this.draw();
  }

  showRing(event) {
    const brush = !this.tool().startsWith("exclude");
    this.ring.hidden = !brush || event.pointerType === "touch";
    if (!brush) return;
    const [x, y] = this.place(event);
    const across = (200 * this.radius) / this.size[0];
    Object.assign(this.ring.style, { left: `${(100 * (x + 0.5)) / this.size[0]}%`, top: `${(100 * (y + 0.5)) / this.size[1]}%`, width: `${across}%` });
  }
}
