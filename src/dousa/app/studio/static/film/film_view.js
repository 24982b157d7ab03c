// One film at one moment: its picture, the people in it, and what a click on them or beside them does.

import { get } from "../core/api.js";
import { decode, h, icon, t } from "../core/dom.js";
import { colourOf } from "./people.js";

// The keypoints of everybody in a film, in pieces that are fetched when they are looked at.
const PIECE = 400; // frames
const SCALE = 16384;
const UNSEEN = -32768;

function bytes(text) {
  const raw = atob(text);
  return Uint8Array.from(raw, (letter) => letter.charCodeAt(0));
}

class Tracks {
  constructor(job, view, nNames, onLoad) {
    Object.assign(this, { job, view, nNames, onLoad, pieces: new Map() });
  }

  /** The piece of a frame, or null while it is on its way. */
  piece(frame) {
    const number = Math.floor(frame / PIECE);
    if (!this.pieces.has(number)) this.load(number);
    return this.pieces.get(number);
  }

  async load(number) {
    this.pieces.set(number, null);
    try {
      const came = await get(`/estimations/${this.job}/film/people/${this.view}`, { first: number * PIECE, count: PIECE });
      const points = new Int16Array(bytes(came.points).buffer);
      this.pieces.set(number, { ...came, points, sure: bytes(came.sure) });
      this.onLoad();
    } catch {
      // nobody was looked for yet, or the studio is away: asked for again with the next version
    }
  }

  /** Who is there in a frame: [{track, points: [[x, y] shares of the picture, or null], sure: [0..1]}]. */
  at(frame) {
    const piece = this.piece(frame);
    if (!piece) return [];
    const row = frame - piece.first;
    if (row < 0 || row >= piece.frames) return [];
    const found = [];
    for (let track = 0; track < piece.people; track += 1) {
      const start = (track * piece.frames + row) * this.nNames;
      const points = [];
      const sure = [];
      for (let k = start; k < start + this.nNames; k += 1) {
        const x = piece.points[2 * k];
        points.push(x === UNSEEN ? null : [x / SCALE, piece.points[2 * k + 1] / SCALE]);
        sure.push(piece.sure[k] / 255);
      }
      if (points.some(Boolean)) found.push({ track, points, sure });
    }
    return found;
  }
}

const NEAR = 16; // px from a bone or point that is still a click on it
const SURE = 0.5;

export class FilmView {
  /** desk: {id, film, choice, model, keypoints}; on: {enlarge(index), pick(person), same(view, track), toggle(view, track)} */
  constructor(desk, index, on) {
    Object.assign(this, { desk, index, on, busy: false, next: null, shown: null, frame: 0 });
    this.image = h("img", { alt: "", hidden: true });
    this.canvas = h("canvas", { "aria-hidden": "true", onclick: (event) => this.click(event) });
    this.picture = h("div", { class: "film-picture" }, this.image, this.canvas);
    this.lost = h("span", { class: "lost-mark", hidden: true });
    this.starts = h("span", { class: "starts" });
    this.button = h("button", { type: "button", class: "small quiet enlarge", onclick: () => on.enlarge(index) });
    this.name = h("b", {});
    this.element = h("figure", { class: "film-view" }, this.picture, this.lost, h("figcaption", {}, this.name, this.starts, this.button));
    this.observer = new ResizeObserver(() => this.draw());
    this.observer.observe(this.picture);
  }

  update(film) {
    const view = film.views[this.index];
    this.name.textContent = view.name;
    this.element.dataset.view = view.name;
    this.picture.style.aspectRatio = `${view.width} / ${view.height}`;
    this.element.style.setProperty("--ratio", String(view.width / view.height));
    this.tracks = new Tracks(this.desk.id, this.index, film.names.length, () => this.draw());
    this.version = film.version;
    this.closeMenu();
  }

  setLarge(large) {
    this.element.classList.toggle("large", large);
    this.button.replaceChildren(icon(large ? "close" : "search"), h("span", { class: "sr" }, t(large ? "view_smaller" : "view_larger", { name: this.name.textContent })));
    this.button.title = t(large ? "view_smaller" : "view_larger", { name: this.name.textContent });
  }

  show(frame, state) {
    this.lost.hidden = !state;
    this.lost.textContent = state ? t(state === "lost" ? "lost" : "unsure") : "";
    this.lost.classList.toggle("unsure", state === "unsure");
    this.element.classList.toggle("lost", state === "lost");
    const { film, model } = this.desk;
    const drawn = model && film.stage === "fitted";
    if (!drawn && !film.views[this.index].film) {
      this.image.hidden = true;
      this.place(frame);
      return;
    }
    const kind = drawn ? "overlay" : "film/picture";
    const key = `${kind}/${frame}/${this.version}`;
    if (key === this.shown) return this.draw();
    this.next = { key, frame, address: `/api/estimations/${this.desk.id}/${kind}/${this.index}/${frame}?v=${this.version}` };
    if (!this.busy) this.load();
  }

  // One picture at a time: whoever plays faster than pictures come sees fewer of them, not old ones.
  async load() {
    const { key, frame, address } = this.next;
    this.next = null;
    this.busy = true;
    try {
      this.showPicture(await decode(address), key, frame);
    } finally {
      this.busy = false;
    }
    if (this.next) this.load();
  }

  showPicture(image, key, frame) {
    if (image) {
      this.image.src = image.src;
      this.image.hidden = false;
      this.image.alt = t("film_picture", { name: this.name.textContent, frame: frame + 1 });
      Object.assign(this, { loaded: image, shown: key });
    }
    this.place(frame); // while the picture is still being read the people show without it
    if (image) this.desk.onPicture();
  }

  place(frame) {
    this.frame = frame;
    this.element.dataset.frame = String(frame);
    this.draw();
  }

  draw() {
    const { canvas, desk } = this;
    const box = this.picture.getBoundingClientRect();
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [Math.round(box.width * ratio), Math.round(box.height * ratio)];
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const context = canvas.getContext("2d");
    context.clearRect(0, 0, width, height);
    if (!desk.keypoints || !this.tracks || desk.film.stage === "films" || !width) return;
    for (const found of this.tracks.at(this.frame)) this.drawPerson(context, found, width, height, ratio);
  }

  drawPerson(context, { track, points, sure }, width, height, ratio) {
    const { choice, film } = this.desk;
    const person = choice.personOf(this.index, track);
    const out = choice.leftOut.has(`${this.index}:${track}`);
    const chosen = person !== null && person === choice.person && !out;
    const colour = out ? colourOf(null) : person === null && film.people.length ? colourOf(null) : colourOf(person ?? track);
    const place = points.map((point) => point && [point[0] * width, point[1] * height]);
    const bones = film.bones.filter(([one, other]) => place[one] && place[other]);
    const stroke = (style, size) => {
      Object.assign(context, { strokeStyle: style, lineWidth: size * ratio, lineCap: "round" });
      context.setLineDash(out ? [3 * ratio, 6 * ratio] : []);
      context.beginPath();
      for (const [one, other] of bones) {
        context.moveTo(...place[one]);
        context.lineTo(...place[other]);
      }
      context.stroke();
    };
    context.globalAlpha = out ? 0.75 : 1;
    stroke("#ffffffcc", chosen ? 4.5 : 3.5);
    stroke(colour, chosen ? 3 : 1.8);
    context.setLineDash([]);
    for (const [k, point] of place.entries()) {
      if (!point) continue;
      context.beginPath();
      context.arc(...point, (chosen ? 2.6 : 2) * ratio, 0, 2 * Math.PI);
      Object.assign(context, { fillStyle: sure[k] >= SURE ? "#ffffff" : "#ffffff00", strokeStyle: colour, lineWidth: 1.2 * ratio });
      context.fill();
      context.stroke();
    }
    this.label(context, place.filter(Boolean), { colour, ratio, text: out ? t("track_left_out") : person === null ? "" : String(person + 1), chosen });
    context.globalAlpha = 1;
  }

  label(context, points, { colour, ratio, text, chosen }) {
    const low = [0, 1].map((k) => Math.min(...points.map((point) => point[k])));
    const high = [0, 1].map((k) => Math.max(...points.map((point) => point[k])));
    if (chosen) {
      Object.assign(context, { strokeStyle: colour, lineWidth: 2 * ratio });
      context.strokeRect(low[0] - 8 * ratio, low[1] - 10 * ratio, high[0] - low[0] + 16 * ratio, high[1] - low[1] + 18 * ratio);
    }
    if (!text) return;
    context.font = `700 ${13 * ratio}px ${getComputedStyle(context.canvas).fontFamily}`; // as the page
    const wide = context.measureText(text).width + 10 * ratio;
    const [x, y] = [Math.min(Math.max(low[0] - 8 * ratio, 0), context.canvas.width - wide), Math.max(low[1] - 28 * ratio, 0)];
    context.fillStyle = colour;
    context.fillRect(x, y, wide, 18 * ratio);
    context.fillStyle = "#ffffff";
    context.fillText(text, x + 5 * ratio, y + 13.5 * ratio);
  }

  click(event) {
    const box = this.canvas.getBoundingClientRect();
    const at = [event.clientX - box.left, event.clientY - box.top];
    const track = this.desk.keypoints && this.tracks ? this.hit(at, box) : null;
    const was = this.menu;
    this.closeMenu();
    if (track !== null) this.openMenu(track, at, box);
    else if (!was) this.on.enlarge(this.index);
  }

  hit([x, y], box) {
    let [best, least] = [null, NEAR];
    for (const { track, points } of this.tracks.at(this.frame)) {
      const place = points.map((point) => point && [point[0] * box.width, point[1] * box.height]);
      for (const [one, other] of this.desk.film.bones) {
        if (!place[one] || !place[other]) continue;
        const far = distance([x, y], place[one], place[other]);
        if (far < least) [best, least] = [track, far];
      }
    }
    return best;
  }

  openMenu(track, [x, y], box) {
    const { choice } = this.desk;
    const person = choice.personOf(this.index, track);
    const out = choice.leftOut.has(`${this.index}:${track}`);
    const act = (text, action) => h("button", { type: "button", class: "small", onclick: () => (this.closeMenu(), action()) }, text);
    const buttons = [
      person !== null && person !== choice.person && !out ? act(t("menu_pick"), () => this.on.pick(person)) : null,
      choice.couldBe(this.index, track) ? act(t("menu_same", { number: choice.person + 1 }), () => this.on.same(this.index, track)) : null,
      act(t(out ? "track_back" : "track_out"), () => this.on.toggle(this.index, track)),
    ];
    const title = person === null ? t("track_name", { number: track + 1 }) : t("person_name", { number: person + 1 });
    this.menu = h(
      "div",
      { class: "film-menu", role: "dialog", "aria-label": title, style: { left: `${Math.min(x, Math.max(box.width - 180, 0))}px`, top: `${Math.min(y, Math.max(box.height - 110, 0))}px` }, onkeydown: (event) => event.key === "Escape" && (event.stopPropagation(), this.closeMenu()) },
      h("b", {}, title),
      ...buttons.filter(Boolean),
    );
    this.picture.append(this.menu);
    this.menu.querySelector("button")?.focus({ preventScroll: true });
  }

  closeMenu() {
    this.menu?.remove();
    this.menu = null;
  }

  destroy() {
    this.observer.disconnect();
  }
}

function distance([x, y], [ax, ay], [bx, by]) {
  const [dx, dy] = [bx - ax, by - ay];
  const share = Math.min(Math.max(((x - ax) * dx + (y - ay) * dy) / Math.max(dx * dx + dy * dy, 1e-9), 0), 1);
  return Math.hypot(x - ax - share * dx, y - ay - share * dy);
}
