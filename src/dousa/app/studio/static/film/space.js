// Where the cameras stand: their pyramids of sight with the pictures that they took, the way that the person goes, and
// the person at the moment.

import { h, t } from "../core/dom.js";
import { onTheme, watchHands } from "../core/theme.js";

// A picture on a plane in space: in cells of two triangles each, which together follow the perspective.
const CELLS = 4; // on each side
const OVER = 0.6; // px by which triangles reach over their edges, so that no seams show

/** Draw an image with its corners (left top, right top, right low, left low; in space) where project(point) puts them. */
function drawOnPlane(context, image, corners, project) {
  const [wide, high] = [image.naturalWidth, image.naturalHeight];
  if (!wide || !high) return;
  const at = (u, v) => project([0, 1, 2].map((k) => (1 - v) * ((1 - u) * corners[0][k] + u * corners[1][k]) + v * ((1 - u) * corners[3][k] + u * corners[2][k])));
  const grid = Array.from({ length: CELLS + 1 }, (_, row) => Array.from({ length: CELLS + 1 }, (_, column) => at(column / CELLS, row / CELLS)));
  const [dx, dy] = [wide / CELLS, high / CELLS];
  for (let row = 0; row < CELLS; row += 1) {
    for (let column = 0; column < CELLS; column += 1) {
      const [a, b, c, d] = [grid[row][column], grid[row][column + 1], grid[row + 1][column + 1], grid[row + 1][column]];
      const [x, y] = [column * dx, row * dy];
      triangle(context, image, [a, b, d], [x, y, dx, dy], false);
      triangle(context, image, [c, d, b], [x + dx, y + dy, dx, dy], true);
    }
  }
}

/** corner: place of the right angle; one along the width, other along the height; source [x, y, dx, dy] of the image. */
function triangle(context, image, [corner, one, other], [x, y, dx, dy], turned) {
  const sign = turned ? -1 : 1;
  const [ax, ay] = [(sign * (one[0] - corner[0])) / dx, (sign * (one[1] - corner[1])) / dx];
  const [bx, by] = [(sign * (other[0] - corner[0])) / dy, (sign * (other[1] - corner[1])) / dy];
  const [mx, my] = [(corner[0] + one[0] + other[0]) / 3, (corner[1] + one[1] + other[1]) / 3];
  context.save();
  context.beginPath();
  for (const [px, py] of [corner, one, other]) {
    const far = Math.hypot(px - mx, py - my) || 1;
    context.lineTo(px + (OVER * (px - mx)) / far, py + (OVER * (py - my)) / far);
  }
  context.clip();
  context.transform(ax, ay, bx, by, corner[0] - ax * x - bx * y, corner[1] - ay * x - by * y);
  context.drawImage(image, 0, 0);
  context.restore();
}

const [NEAREST, FARTHEST] = [0.4, 2.5]; // zoom
const STEP = 0.12; // rad, of an arrow key
const ROOM = 0.84; // of the canvas, that cameras and person fill
const GROWN = 1.7; // times as large as cameras are told, so that their pictures can be seen

export class Space {
  /** pictureOf(camera's number) -> its decoded image at the moment, or null */
  constructor(canvas, list, pictureOf = () => null) {
    Object.assign(this, { canvas, list, pictureOf, cameras: [], joints: null, parents: [], frame: 0, colour: "#e8590c" });
    this.reset();
    this.ended = new AbortController();
    this.probe = h("span", { class: "space-colours", "aria-hidden": "true", hidden: true }, ...["ink", "soft", "line", "accent"].map((name) => h("i", { class: name })));
    canvas.after(this.probe);
    this.listen();
  }

  reset() {
    Object.assign(this, { turn: 0.6, tilt: 0.42, zoom: 1 });
  }

  listen() {
    const { canvas } = this;
    const { signal } = this.ended;
    const change = (turn, tilt, zoom = 1) => {
      this.turn += turn;
      this.tilt = Math.min(Math.max(this.tilt + tilt, -0.1), 1.57);
      this.zoom = Math.min(Math.max(this.zoom * zoom, NEAREST), FARTHEST);
      this.draw();
      return true;
    };
    const hooks = {
      press: () => {},
      turn: (across, down) => change(0.008 * across, 0.006 * down),
      scale: (factor) => change(0, 0, factor),
      reset: () => (this.reset(), this.draw()),
      takesWheel: () => document.activeElement === canvas,
    };
    watchHands(canvas, hooks, signal);
    const keys = { ArrowLeft: [-STEP, 0], ArrowRight: [STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP], "+": [0, 0, 1.15], "-": [0, 0, 1 / 1.15] };
    canvas.addEventListener("keydown", (event) => {
      if (!keys[event.key]) return;
      event.preventDefault();
      change(...keys[event.key]);
    }, { signal });
    this.observer = new ResizeObserver(() => this.draw());
    this.observer.observe(canvas);
    this.endTheme = onTheme(() => this.draw());
  }

  /** cameras: [{name, position, corners}]; joints: Float32Array of (frames, 20, 3) or null; parents of the joints. */
  set(cameras, joints, parents, colour) {
    cameras = cameras.map((camera) => ({ ...camera, corners: camera.corners.map((corner) => corner.map((value, k) => camera.position[k] + GROWN * (value - camera.position[k]))) }));
    Object.assign(this, { cameras, joints, parents, colour });
    const places = cameras.map((camera) => camera.position);
    const path = this.path();
    const all = [...places, ...path];
    const middle = path.length ? path : places;
    this.centre = [0, 1, 2].map((k) => middle.reduce((sum, place) => sum + place[k], 0) / Math.max(middle.length, 1));
    this.reach = Math.max(1.5, ...all.map((place) => Math.hypot(place[0] - this.centre[0], place[2] - this.centre[2])));
    const away = ({ position }) => Math.hypot(position[0] - this.centre[0], position[2] - this.centre[2]).toFixed(1);
    const say = (camera) => t("camera_place", { away: away(camera), high: camera.position[1].toFixed(1) });
    this.list.replaceChildren(...cameras.map((camera) => h("li", {}, h("b", {}, camera.name), " ", say(camera))));
    this.draw();
  }

  path() {
    if (!this.joints) return [];
    const frames = this.joints.length / 60;
    const every = Math.max(1, Math.floor(frames / 200));
    const found = [];
    for (let frame = 0; frame < frames; frame += every) {
      const place = [...this.joints.subarray(60 * frame, 60 * frame + 3)];
      if (place.every(Number.isFinite)) found.push(place);
    }
    return found;
  }

  show(frame) {
    this.frame = frame;
    this.draw();
  }

  turned([x, y, z]) {
    const [dx, dy, dz] = [x - this.centre[0], y - 0.8, z - this.centre[2]];
    const [c, s] = [Math.cos(this.turn), Math.sin(this.turn)];
    const [right, forward] = [c * dx + s * dz, -s * dx + c * dz];
    const [ct, st] = [Math.cos(this.tilt), Math.sin(this.tilt)];
    return [right, ct * dy - st * forward, st * dy + ct * forward];
  }

  project(place) {
    const [right, up, near] = this.turned(place);
    const far = 3.2 * this.reach;
    const scale = (this.size * this.zoom) / Math.max(far - near, 0.1);
    return [this.middle[0] + scale * right, this.middle[1] - scale * up];
  }

  draw() {
    const { canvas } = this;
    const box = canvas.getBoundingClientRect();
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [Math.round(box.width * ratio), Math.round(box.height * ratio)];
    if (!width || !height || !this.cameras.length) return;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    Object.assign(this, { middle: [width / 2, height / 2], ratio });
    this.fit(width, height);
    const context = canvas.getContext("2d");
    context.clearRect(0, 0, width, height);
    this.probe.hidden = false;
    const [ink, soft, line, accent] = [...this.probe.children].map((element) => getComputedStyle(element).color);
    this.probe.hidden = true;
    this.floor(context, line);
    this.pictures(context);
    for (const camera of this.cameras) this.camera(context, camera, accent, ink);
    this.person(context, soft);
  }

  fit(width, height) {
    const zoom = this.zoom;
    Object.assign(this, { size: 1, zoom: 1 });
    const ground = this.cameras.map(({ position: [x, , z] }) => [x, 0, z]);
    const all = [...this.cameras.flatMap((camera) => [camera.position, ...camera.corners]), ...ground].map((place) => this.project(place));
    const [left, right, top, low] = [[0, Math.min], [0, Math.max], [1, Math.min], [1, Math.max]].map(([k, pick]) => pick(...all.map((place) => place[k] - this.middle[k])));
    this.size = (ROOM * Math.min(width / Math.max(right - left, 1e-6), height / Math.max(low - top, 1e-6))) || 1;
    this.zoom = zoom;
    this.middle = [width / 2 - (this.size * (left + right)) / 2, height / 2 - (this.size * (top + low)) / 2];
  }

  line(context, points, style, width) {
    Object.assign(context, { strokeStyle: style, lineWidth: width * this.ratio, lineCap: "round", lineJoin: "round" });
    context.beginPath();
    for (const point of points) context.lineTo(...this.project(point));
    context.stroke();
  }

  floor(context, style) {
    const far = Math.ceil(this.reach) + 0.5;
    const [x, z] = [Math.round(this.centre[0]), Math.round(this.centre[2])];
    for (let k = -Math.floor(far); k <= far; k += 1) {
      this.line(context, [[x + k, 0, z - far], [x + k, 0, z + far]], style, 1);
      this.line(context, [[x - far, 0, z + k], [x + far, 0, z + k]], style, 1);
    }
  }

  pictures(context) {
    const away = ({ corners }) => Math.min(...corners.map((corner) => this.turned(corner)[2]));
    const shown = this.cameras.map((camera, index) => ({ camera, image: this.pictureOf(index) })).filter(({ image }) => image);
    shown.sort((one, other) => away(one.camera) - away(other.camera));
    for (const { camera, image } of shown) drawOnPlane(context, image, camera.corners, (place) => this.project(place));
    this.canvas.dataset.pictures = String(shown.length);
  }

  camera(context, { name, position, corners }, style, ink) {
    for (const corner of corners) this.line(context, [position, corner], style, 1.3);
    this.line(context, [...corners, corners[0]], style, 1.6);
    this.line(context, [position, [position[0], 0, position[2]]], style, 0.6);
    const [x, y] = this.project(position);
    context.fillStyle = style;
    context.beginPath();
    context.arc(x, y, 4 * this.ratio, 0, 2 * Math.PI);
    context.fill();
    context.fillStyle = ink;
    context.font = `600 ${12 * this.ratio}px ${getComputedStyle(context.canvas).fontFamily}`; // as the page
    const text = name.slice(0, 20);
    const wide = context.measureText(text).width + 7 * this.ratio;
    context.fillText(text, x + wide > this.canvas.width ? x - wide : x + 7 * this.ratio, y - 6 * this.ratio);
  }

  person(context, soft) {
    const path = this.path();
    if (path.length > 1) this.line(context, path.map(([x, , z]) => [x, 0, z]), soft, 1.5);
    if (!this.joints || 60 * (this.frame + 1) > this.joints.length) return;
    const own = this.joints.subarray(60 * this.frame, 60 * this.frame + 60);
    const joint = (k) => [...own.subarray(3 * k, 3 * k + 3)];
    for (const [child, parent] of this.parents.entries()) {
      const bone = [joint(parent < 0 ? child : parent), joint(child)];
      if (parent >= 0 && bone.flat().every(Number.isFinite)) this.line(context, bone, this.colour, 3);
    }
  }

  destroy() {
    this.ended.abort();
    this.observer.disconnect();
    this.endTheme();
    this.probe.remove();
    this.list.replaceChildren();
  }
}
