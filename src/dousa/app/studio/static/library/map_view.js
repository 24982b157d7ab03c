// What part of the map is seen, and how it is moved: wheel, two fingers, dragging, keys; and lines drawn around clips.

// Many dots on a canvas, drawn pixel by pixel: ten thousand take a few milliseconds, where arcs would take fifty.

const masks = new Map(); // radius -> [offsets to the left and up, coverages]

/** How much of each pixel about a dot's middle it covers, 0 to 255: {reach, covers: rows of 2 * reach + 1} */
function maskOf(radius) {
  const known = masks.get(radius);
  if (known) return known;
  const reach = Math.ceil(radius + 0.5);
  const covers = new Uint8Array((2 * reach + 1) ** 2);
  for (let at = 0, y = -reach; y <= reach; y += 1) for (let x = -reach; x <= reach; x += 1, at += 1) covers[at] = Math.round(255 * Math.min(Math.max(radius + 0.5 - Math.hypot(x, y), 0), 1));
  const made = { reach, covers };
  masks.set(radius, made);
  return made;
}

/** "#rrggbb" as a pixel without its opacity. */
export const inkOf = (colour) => {
  const [r, g, b] = [1, 3, 5].map((at) => Number.parseInt(colour.slice(at, at + 2), 16));
  return (b << 16) | (g << 8) | r;
};

export class Dots {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.resize(1, 1);
  }

  resize(width, height) {
    this.canvas.width = Math.max(width, 1);
    this.canvas.height = Math.max(height, 1);
    this.image = this.context.createImageData(this.canvas.width, this.canvas.height);
    this.pixels = new Uint32Array(this.image.data.buffer);
  }

  begin() {
    this.pixels.fill(0);
  }

  /** A dot about (x, y) in pixels of the canvas; what was drawn before lies above it. opacity: 0 to 1 */
  dot(x, y, radius, ink, opacity = 1) {
    const { reach, covers } = maskOf(radius);
    const { pixels, canvas: { width, height } } = this;
    const [left, top] = [Math.round(x) - reach, Math.round(y) - reach];
    const side = 2 * reach + 1;
    if (left >= width || top >= height || left + side <= 0 || top + side <= 0) return;
    const [fromX, toX] = [Math.max(-left, 0), Math.min(side, width - left)];
    const toY = Math.min(side, height - top);
    for (let row = Math.max(-top, 0); row < toY; row += 1) {
      let at = (top + row) * width + left + fromX;
      for (let k = row * side + fromX; k < row * side + toX; k += 1, at += 1) {
        const cover = (covers[k] * opacity) | 0;
        if (cover > pixels[at] >>> 24) pixels[at] = ((cover << 24) | ink) >>> 0;
      }
    }
  }

  end() {
    this.context.putImageData(this.image, 0, 0);
  }
}

const [LEAST, MOST] = [0.8, 60]; // times the whole map
const NEAR = 9; // px from a dot that count as on it
const STILL = 4; // px that a press may move and is no drag
const KEY_STEP = 60; // px
const KEY_ZOOM = 1.35;

/** hooks: draw(), hover(x, y) or hover(null), click(x, y, event), open(x, y), around(polygon, event), key(event) -> true if used */
export class MapView {
  constructor(element, hooks) {
    Object.assign(this, { element, hooks, mode: "lasso", zoom: 1, x: 0, y: 0, width: 1, height: 1, lasso: null, fingers: new Map() });
    element.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    element.addEventListener("pointerdown", (event) => this.down(event));
    element.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"]) element.addEventListener(name, (event) => this.up(event));
    element.addEventListener("pointerleave", () => hooks.hover(null));
    element.addEventListener("dblclick", (event) => hooks.open(...this.at(event)));
    element.addEventListener("contextmenu", (event) => this.moved && event.preventDefault());
    element.addEventListener("keydown", (event) => this.keydown(event));
  }

  resize(width, height) {
    Object.assign(this, { width, height });
    this.hooks.draw();
  }

  get unit() {
    return 0.47 * Math.min(this.width, this.height) * this.zoom;
  }

  /** Where a point of the map is seen, px from the corner. */
  screen(x, y) {
    return [this.width / 2 + (x - this.x) * this.unit, this.height / 2 - (y - this.y) * this.unit];
  }

  at(event) {
    const box = this.element.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  whole() {
    Object.assign(this, { zoom: 1, x: 0, y: 0 });
    this.hooks.draw();
  }

  scale(factor, [x, y] = [this.width / 2, this.height / 2]) {
    const before = this.unit;
    this.zoom = Math.min(Math.max(this.zoom * factor, LEAST), MOST);
    const change = 1 / before - 1 / this.unit;
    this.x += (x - this.width / 2) * change;
    this.y -= (y - this.height / 2) * change;
    this.hooks.draw();
  }

  shift(x, y) {
    this.x = Math.min(Math.max(this.x - x / this.unit, -1.2), 1.2);
    this.y = Math.min(Math.max(this.y + y / this.unit, -1.2), 1.2);
    this.hooks.draw();
  }

  wheel(event) {
    event.preventDefault();
    this.hooks.hover(null);
    const px = event.deltaY * (event.deltaMode === 1 ? 32 : 1);
    this.scale(Math.exp(-0.0016 * px), this.at(event));
  }

  down(event) {
    if (event.pointerType !== "mouse" || event.button === 0) this.element.focus({ preventScroll: true });
    this.element.setPointerCapture(event.pointerId);
    this.fingers.set(event.pointerId, this.at(event));
    this.hooks.hover(null);
    if (this.fingers.size > 1) {
      this.lasso = null;
      this.moved = true;
      this.hooks.draw();
      return;
    }
    this.moved = false;
    this.pans = this.mode === "move" || event.button > 0;
    this.from = this.at(event);
    this.lasso = this.pans ? null : [this.from];
  }

  move(event) {
    const place = this.at(event);
    const last = this.fingers.get(event.pointerId);
    if (!last) {
      if (event.pointerType === "mouse") this.hooks.hover(...place);
      return;
    }
    if (this.fingers.size > 1) this.pinch(event.pointerId, last, place);
    this.fingers.set(event.pointerId, place);
    if (this.fingers.size > 1) return;
    if (Math.hypot(place[0] - this.from[0], place[1] - this.from[1]) > STILL) this.moved = true;
    if (!this.moved) return;
    if (this.pans) this.shift(place[0] - last[0], place[1] - last[1]);
    else if (this.lasso) {
      this.lasso.push(place);
      this.hooks.draw();
    }
  }

  pinch(id, last, place) {
    const [, other] = [...this.fingers].find(([one]) => one !== id);
    const away = (one) => Math.max(Math.hypot(one[0] - other[0], one[1] - other[1]), 1);
    this.shift((place[0] - last[0]) / 2, (place[1] - last[1]) / 2);
    this.scale(away(place) / away(last), [(place[0] + other[0]) / 2, (place[1] + other[1]) / 2]);
  }

  up(event) {
    if (!this.fingers.delete(event.pointerId) || this.fingers.size) return;
    const line = this.lasso;
    this.lasso = null;
    if (event.type === "pointercancel") this.hooks.draw();
    else if (!this.moved && event.button <= 0) this.hooks.click(...this.at(event), event);
    else if (line && line.length > 2) this.hooks.around(line, event);
    this.hooks.draw();
  }

  keydown(event) {
    const moves = { ArrowLeft: [KEY_STEP, 0], ArrowRight: [-KEY_STEP, 0], ArrowUp: [0, KEY_STEP], ArrowDown: [0, -KEY_STEP] };
    const acts = { "+": () => this.scale(KEY_ZOOM), "=": () => this.scale(KEY_ZOOM), "-": () => this.scale(1 / KEY_ZOOM), 0: () => this.whole() };
    const free = !event.ctrlKey && !event.metaKey && !event.altKey;
    if (free && event.key in moves) this.shift(...moves[event.key]);
    else if (free && event.key in acts) acts[event.key]();
    else if (!this.hooks.key(event)) return;
    event.preventDefault();
  }

  /** The nearest of some places (x, y in turns) to a place; -1 if none is near. */
  static nearest(places, count, x, y) {
    let [best, found] = [NEAR * NEAR, -1];
    for (let k = 0; k < count; k += 1) {
      const away = (places[2 * k] - x) ** 2 + (places[2 * k + 1] - y) ** 2;
      if (away < best) [best, found] = [away, k];
    }
    return found;
  }

  /** -> function (x, y): whether a place lies within a line that is closed from its end to its beginning */
  static enclosure(line) {
    const [xs, ys] = [0, 1].map((axis) => Float64Array.from(line, (point) => point[axis]));
    const [left, right, top, bottom] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    return (x, y) => {
      if (x < left || x > right || y < top || y > bottom) return false; // most of very many are far away
      let within = false;
      for (let k = 0, last = xs.length - 1; k < xs.length; last = k, k += 1) {
        if (ys[k] > y !== ys[last] > y && x < ((xs[last] - xs[k]) * (y - ys[k])) / (ys[last] - ys[k]) + xs[k]) within = !within;
      }
      return within;
    };
  }
}
