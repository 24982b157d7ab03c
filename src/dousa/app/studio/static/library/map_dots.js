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
