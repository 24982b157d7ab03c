// The map of all clips: what resembles each other lies together. Clips are chosen by a line drawn around them; the list
// shows the same clips for those who use the keyboard or a screen reader.

import { get, getFigures, post } from "../core/api.js";
import { count, h, language, later, t } from "../core/dom.js";
import { followJob, isActive, stopJob } from "../core/jobs.js";
import { attempt } from "../core/notices.js";
import { onTheme } from "../core/theme.js";
import { Dots, inkOf, MapView } from "./map_view.js";

const COLOURS = {
  light: ["#3b528b", "#b8460a", "#117733", "#aa4499", "#0e8fb3", "#882255", "#8a7a00", "#cc3355", "#2f8f83", "#7a5230"],
  dark: ["#8fa8f0", "#ff9a57", "#5fd07a", "#e28ad8", "#62c8ea", "#ff7fae", "#d9ca50", "#ff8f85", "#4fd0c0", "#cfa277"],
};
const OTHER = { light: "#7d8695", dark: "#8a94a4" };
const INK = { light: "#1b2130", dark: "#ffffff" };
const FAINT = 0.16; // opacity of what the filter or the legend leaves out
const MOST_LISTED = 400; // categories of the legend
const dark = window.matchMedia("(prefers-color-scheme: dark)");
const theme = () => (document.documentElement.dataset.theme ?? (dark.matches ? "dark" : "light")) === "dark" ? "dark" : "light";

/** hooks: selection, query() -> filter, narrows() -> bool, fitting() -> promise of numbers, open(clip), key(event) */
export class ClipMap {
  constructor(element, hooks) {
    Object.assign(this, { element, hooks, ids: [], groups: [], lit: new Set(), fits: null, hovered: -1, known: new Map(), isOpen: false });
    this.base = h("canvas", { class: "mp-canvas" });
    this.over = h("canvas", { class: "mp-canvas mp-over", tabIndex: 0, role: "img" });
    this.tip = h("div", { class: "mp-tip", hidden: true });
    this.stage = h("div", { class: "mp-stage" }, this.base, this.over, this.tip);
    this.legend = h("div", { class: "mp-legend", role: "group", "aria-label": t("map_legend") });
    this.state = h("div", { class: "mp-state row", role: "status" });
    this.bar = h("div", { class: "mp-bar row" }, ...this.makeTools());
    this.wait = h("div", { class: "mp-wait empty", hidden: true });
    this.body = h("div", { class: "mp-body" }, this.stage, this.legend);
    element.append(this.bar, this.body, this.wait, h("p", { class: "note mp-hint" }, t("map_hint")));
    this.dots = new Dots(this.base);
    this.view = new MapView(this.over, {
      draw: () => this.request(),
      hover: (x, y) => this.hover(x, y),
      click: (x, y, event) => this.click(x, y, event),
      open: (x, y) => this.open(x, y),
      around: (line, event) => this.choose(line, event),
      key: (event) => hooks.key(event),
    });
    this.over.map = this; // for tests
    new ResizeObserver(() => this.resize()).observe(this.stage);
    onTheme(() => this.recolour());
    this.ask = later((id) => attempt(() => this.tell(id)), 70);
  }

  makeTools() {
    const mode = (name) => h("button", { type: "button", class: "small", dataset: { mode: name }, "aria-pressed": String(name === "lasso"), title: t(`map_${name}_title`), onclick: () => {
      this.view.mode = name;
      for (const one of this.bar.querySelectorAll("[data-mode]")) one.setAttribute("aria-pressed", String(one.dataset.mode === name));
      this.over.classList.toggle("mp-moves", name === "move");
    } }, t(`map_${name}`));
    const act = (name, sign, action) => h("button", { type: "button", class: "small icon", "aria-label": t(name), title: t(name), onclick: action }, sign);
    return [
      h("div", { class: "row mp-group", role: "group", "aria-label": t("map_drag") }, mode("lasso"), mode("move")),
      h("div", { class: "row mp-group" }, act("map_larger", "+", () => this.view.scale(1.5)), act("map_smaller", "−", () => this.view.scale(1 / 1.5)), h("button", { type: "button", class: "small", onclick: () => this.view.whole() }, t("map_whole"))),
      this.state,
    ];
  }

  show() {
    this.isOpen = true;
    this.element.hidden = false;
    attempt(() => this.load({ makes: true }));
  }

  hide() {
    this.isOpen = false;
    this.element.hidden = true;
    this.hover(null);
  }

  async load({ makes = false } = {}) {
    const found = await get("/map");
    if (!this.isOpen) return;
    this.take(found);
    const active = (await get("/jobs", { kind: "map", active: true })).jobs[0];
    if (active) this.follow(active.id);
    else if (!found.is_made && makes && found.n_new) await this.make();
    else this.showState();
  }

  take(found) {
    const [high, grouped] = [found.categories.map((name) => name.split("/")[0]), new Set(found.categories.map((name) => name.split("/")[0]))];
    const names = grouped.size > 1 && grouped.size < found.categories.length ? high : found.categories;
    const sizes = new Map();
    for (const code of found.category) sizes.set(names[code], (sizes.get(names[code]) ?? 0) + 1);
    const order = [...sizes.keys()].sort((a, b) => (a === "") - (b === "") || sizes.get(b) - sizes.get(a) || a.localeCompare(b, language, { numeric: true }));
    this.groups = order.map((name, place) => ({ name, size: sizes.get(name), place }));
    const placeOf = new Map(order.map((name, place) => [name, place]));
    this.found = found;
    this.ids = found.ids;
    this.group = Uint16Array.from(found.category, (code) => placeOf.get(names[code]));
    this.places = new Float32Array(2 * this.ids.length);
    this.lit = new Set([...this.lit].filter((name) => sizes.has(name)));
    this.over.setAttribute("aria-label", t("map_label", { count: count.format(this.ids.length) }));
    this.showLegend();
    this.narrow();
  }

  async narrow() {
    const round = (this.round = (this.round ?? 0) + 1);
    const fitting = this.hooks.narrows() ? new Set(await this.hooks.fitting()) : null;
    if (round !== this.round) return;
    this.fits = fitting && Uint8Array.from(this.ids, (id) => Number(fitting.has(id)));
    this.request();
  }

  async make() {
    this.follow((await post("/jobs/map")).id);
  }

  follow(id) {
    this.end?.();
    this.job = null;
    this.end = followJob(id, (job) => {
      this.job = job;
      if (!isActive(job)) {
        this.end?.();
        this.end = null;
        if (job.state === "done") {
          this.job = null;
          attempt(() => this.load());
        }
      }
      this.showState();
    });
  }

  showState() {
    const { found, job } = this;
    const renew = (word) => h("button", { type: "button", class: "small", id: word.replace("_", "-"), onclick: () => attempt(() => this.make()) }, t(word));
    const running = job && isActive(job);
    const progress = running ? h("progress", { max: String(Math.max(job.total, 1)), value: job.total ? String(job.done) : null, "aria-label": t("kind_map") }) : null;
    const stop = running ? h("button", { type: "button", class: "small", onclick: () => attempt(() => stopJob(job.id)) }, t("stop")) : null;
    const problem = job && job.problem ? h("p", { class: "problem-box" }, job.problem) : null;
    const none = !this.ids.length;
    this.body.hidden = none;
    this.bar.hidden = none;
    this.wait.hidden = !none;
    if (none) {
      this.wait.replaceChildren(...[h("p", {}, t(running || found.n_new ? "map_making" : "map_nothing")), problem, progress, running && job.what ? h("p", { class: "note" }, job.what) : null, running ? stop : found.n_new ? renew("map_make") : null].filter(Boolean));
      return;
    }
    const notes = [t("map_count", { count: count.format(this.ids.length) })];
    if (found.n_new) notes.push(t("map_new", { count: count.format(found.n_new) }));
    if (found.n_left_out) notes.push(t("map_left_out", { count: count.format(found.n_left_out) }));
    this.state.replaceChildren(...[h("span", { class: "note" }, notes.join(" · ")), problem, progress, running ? stop : found.n_new ? renew("map_renew") : null].filter(Boolean));
  }

  recolour() {
    this.showLegend();
    this.request();
  }

  colourOf(place) {
    const { name } = this.groups[place];
    return name === "" ? OTHER[theme()] : (COLOURS[theme()][place] ?? OTHER[theme()]);
  }

  showLegend() {
    const row = ({ name, size, place }) => h("button", { type: "button", class: "quiet small mp-row", "aria-pressed": String(this.lit.has(name)), title: name, dataset: { name }, onclick: () => {
      if (!this.lit.delete(name)) this.lit.add(name);
      this.recolour();
      this.legend.querySelector(`[data-name="${CSS.escape(name)}"]`)?.focus();
    } }, h("i", { class: `mp-swatch${name === "" || place >= COLOURS.light.length ? " mp-plain" : ""}`, style: { background: this.colourOf(place) } }), h("span", { class: "name" }, name || t("no_label")), h("span", { class: "n" }, count.format(size)));
    this.legend.replaceChildren(...this.groups.slice(0, MOST_LISTED).map(row));
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.stage;
    if (!width || !height) return;
    this.ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [wide, high] = [Math.round(width * this.ratio), Math.round(height * this.ratio)];
    this.dots.resize(wide, high);
    [this.over.width, this.over.height] = [wide, high];
    this.view.resize(width, height);
  }

  request() {
    this.waiting ??= requestAnimationFrame(() => this.draw());
  }

  draw() {
    this.waiting = undefined;
    if (!this.isOpen || !this.ids.length || !this.ratio) return;
    const { view, ids, places, group, fits, lit, dots, ratio } = this;
    const { x, y } = this.found;
    const inks = this.groups.map((_, place) => inkOf(this.colourOf(place)));
    const shown = lit.size ? this.groups.map(({ name }) => lit.has(name)) : null;
    const [radius, ink] = [this.radius(), inkOf(INK[theme()])];
    const { selection } = this.hooks;
    const [plain, faint] = [[], []];
    dots.begin();
    for (let k = 0; k < ids.length; k += 1) {
      [places[2 * k], places[2 * k + 1]] = view.screen(x[k], y[k]);
      if (selection.size && selection.has(ids[k])) {
        dots.dot(places[2 * k] * ratio, places[2 * k + 1] * ratio, radius + 1, inks[group[k]]);
        dots.dot(places[2 * k] * ratio, places[2 * k + 1] * ratio, radius + 3.5, ink);
      } else ((fits && !fits[k]) || (shown && !shown[group[k]]) ? faint : plain).push(k);
    }
    for (const k of plain) dots.dot(places[2 * k] * ratio, places[2 * k + 1] * ratio, radius, inks[group[k]]);
    for (const k of faint) dots.dot(places[2 * k] * ratio, places[2 * k + 1] * ratio, radius, inks[group[k]], FAINT);
    dots.end();
    this.drawOver();
  }

  radius() {
    const few = Math.min(Math.max(110 / Math.sqrt(this.ids.length), 1.5), 6);
    return Math.round(2 * this.ratio * few * Math.min(this.view.zoom ** 0.35, 3)) / 2;
  }

  drawOver() {
    const context = this.over.getContext("2d");
    const { ratio, view, hovered, places } = this;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, view.width, view.height);
    context.strokeStyle = context.fillStyle = INK[theme()];
    if (hovered >= 0) {
      context.lineWidth = 2;
      context.beginPath();
      context.arc(places[2 * hovered], places[2 * hovered + 1], this.radius() / ratio + 4, 0, 7);
      context.stroke();
    }
    if (!view.lasso || view.lasso.length < 2) return;
    context.beginPath();
    for (const [x, y] of view.lasso) context.lineTo(x, y);
    context.closePath();
    context.globalAlpha = 0.1;
    context.fill();
    context.globalAlpha = 1;
    context.lineWidth = 1.5;
    context.setLineDash([5, 4]);
    context.stroke();
    context.setLineDash([]);
  }

  hover(x, y) {
    const found = x === null ? -1 : MapView.nearest(this.places ?? [], this.ids.length, x, y);
    if (found === this.hovered) return;
    this.hovered = found;
    this.over.classList.toggle("mp-on", found >= 0);
    this.tip.hidden = true;
    this.drawOver();
    if (found >= 0) this.ask(this.ids[found]);
  }

  async clip(id) {
    if (!this.known.has(id)) {
      if (this.known.size > 300) this.known.clear();
      const [clip, [figure]] = await Promise.all([get(`/clips/${id}`), getFigures([id])]);
      this.known.set(id, { clip, figure });
    }
    return this.known.get(id);
  }

  async tell(id) {
    const { clip, figure } = await this.clip(id);
    const at = this.hovered;
    if (at < 0 || this.ids[at] !== id) return;
    this.miniature?.destroy();
    this.miniature = null;
    const canvas = h("canvas", { class: "mp-figure" });
    this.tip.replaceChildren(canvas, h("b", {}, clip.name), h("span", { class: "note" }, [clip.category ?? t("no_label"), clip.performer].filter(Boolean).join(" · ")));
    this.tip.hidden = false;
    if (figure) this.miniature = window.dousa.createMiniature(canvas, figure, { host: this.over });
    const [x, y] = [this.places[2 * at], this.places[2 * at + 1]];
    const { offsetWidth: width, offsetHeight: height } = this.tip;
    this.tip.style.left = `${Math.min(Math.max(x + 18 + width > this.view.width ? x - width - 18 : x + 18, 4), Math.max(this.view.width - width - 4, 4))}px`;
    this.tip.style.top = `${Math.min(Math.max(y - height / 2, 4), Math.max(this.view.height - height - 4, 4))}px`;
  }

  open(x, y) {
    const at = MapView.nearest(this.places, this.ids.length, x, y);
    if (at >= 0) attempt(async () => this.hooks.open((await this.clip(this.ids[at])).clip));
  }

  click(x, y, event) {
    const at = MapView.nearest(this.places, this.ids.length, x, y);
    if (at < 0) return;
    const id = this.ids[at];
    const { selection } = this.hooks;
    if (event.ctrlKey || event.metaKey || event.shiftKey || event.pointerType === "touch") this.set(selection.has(id) ? selection.ids.filter((one) => one !== id) : [...selection.ids, id]);
    else attempt(async () => selection.restore([[id, (await this.clip(id)).clip]]));
  }

  choose(line, event) {
    const { ids, places, fits, groups, group, lit } = this;
    const isInside = MapView.enclosure(line);
    const within = ids.filter((_, k) => (!fits || fits[k]) && (!lit.size || lit.has(groups[group[k]].name)) && isInside(places[2 * k], places[2 * k + 1]));
    const chosen = new Set(within);
    const { selection } = this.hooks;
    if (event.altKey) this.set(selection.ids.filter((id) => !chosen.has(id)));
    else this.set(event.shiftKey ? [...new Set([...selection.ids, ...within])] : within);
  }

  set(ids) {
    if (ids.length) this.hooks.selection.all(ids);
    else this.hooks.selection.clear();
    this.request();
  }
}
