// Silhouettes looked through and repaired before, or after, they are fitted (?masks=JOB, &of= an estimation of them).

import { get, post } from "../core/api.js";
import { $, decode, formatSeconds, h, icon, t } from "../core/dom.js";
import { followJob, isActive } from "../core/jobs.js";
import { attempt } from "../core/notices.js";
import { Sheet, Strip } from "./sheet.js";

const TOOLS = { add: "b", remove: "e", exclude: "x", exclude_through: "t" };
const UNSURE = 0.7; // overlap of silhouette and model, below which a frame is doubtful
const [LEAST, MOST] = [1, 120]; // px of the brush

export class Editor {
  /** id: of the job whose silhouettes are shown; onJob(id) when an estimation of them was started */
  constructor(id, { of, onJob, startOver }) {
    Object.assign(this, { id, of, onJob, startOver, state: null, view: 0, frame: 0, tool: "add", version: 0, overlaps: new Map(), saving: Promise.resolve(), pending: 0 });
    $("#masks-desk").hidden = true;
    $("#masks-problem").replaceChildren();
    $("#masks-actions").replaceChildren();
    $("#masks-waiting").hidden = false;
    this.onKey = (event) => this.press(event);
    document.addEventListener("keydown", this.onKey);
    this.unfollow = followJob(id, (job) => this.showJob(job));
    get(`/jobs/${id}`).catch((error) => this.refuse(error.message));
  }

  end() {
    this.ended = true;
    this.unfollow();
    document.removeEventListener("keydown", this.onKey);
    this.strip?.destroy();
    $("#masks-desk").replaceChildren();
  }

  refuse(problem) {
    $("#masks-waiting").hidden = true;
    $("#masks-problem").replaceChildren(h("p", { class: "problem-box" }, problem));
    $("#masks-actions").replaceChildren(h("button", { type: "button", onclick: this.startOver }, t("new_estimation")));
  }

  async showJob(job) {
    if (this.ended || this.state) return;
    this.job = job;
    if (isActive(job)) {
      const bar = $("#masks-bar");
      if (job.total > 1) Object.assign(bar, { max: job.total, value: job.done });
      $("#masks-what").textContent = job.what;
      return;
    }
    if (job.state !== "done") return this.refuse(job.problem ?? t(`state_${job.state}`));
    await attempt(() => this.begin());
  }

  async begin() {
    const state = await get(`/masks/${this.id}`);
    if (this.ended || this.state) return;
    this.state = state;
    $("#masks-waiting").hidden = true;
    this.build();
    $("#masks-desk").hidden = false;
    this.take(state);
    if (this.of) await this.loadOverlaps().catch(() => {}); // the estimation was forgotten: the rest goes on without
    const first = this.list()[0];
    this.goTo(first?.frame ?? 0, first?.view ?? 0);
  }

  build() {
    const { views, n_frames: total } = this.state;
    const button = (name, act, { key, ...more } = {}) => h("button", { type: "button", class: "small", id: `masks-${name}`, title: key ? `${t(`masks_${name}`)} (${key})` : undefined, onclick: act, ...more }, t(`masks_${name}`));
    const stroke = ({ adds, points, radius }) => this.repair({ action: adds ? "add" : "remove", points, radius });
    this.sheet = new Sheet({ stroke, click: (point) => this.repair({ action: this.tool, points: [point] }) }, () => this.tool);
    this.sheet.stage.setAttribute("aria-label", t("masks_stage"));
    this.strip = new Strip((view, frame) => this.goTo(frame, view));
    this.tools = Object.entries(TOOLS).map(([tool, key]) => button(tool, () => this.setTool(tool), { key: key.toUpperCase(), dataset: { tool } }));
    this.tabs = views.map((view, index) => h("button", { type: "button", class: "small", dataset: { view: String(index) }, onclick: () => this.goTo(this.frame, index) }, view.name));
    this.radius = h("input", { type: "range", id: "masks-size", min: String(LEAST), max: String(MOST), value: "8", oninput: () => this.setRadius(Number(this.radius.value)) });
    this.slider = h("input", { type: "range", id: "masks-frame", min: "0", max: String(total - 1), value: "0", "aria-label": t("frame_label"), oninput: () => this.goTo(Number(this.slider.value)) });
    this.undoButton = button("undo", () => this.send("undo", {}), { key: "Ctrl+Z" });
    this.redoButton = button("redo", () => this.send("redo", {}), { key: "Ctrl+Y" });
    this.nextButton = button("next", () => this.goDoubtful(1), { key: "N" });
    this.now = h("p", { id: "masks-now", role: "status" });
    this.left = h("p", { id: "masks-left", class: "note" });
    $("#masks-desk").replaceChildren(
      h("div", { class: "row masks-tools" }, ...(views.length > 1 ? [h("div", { class: "row", role: "group", "aria-label": t("masks_views") }, ...this.tabs)] : []), h("div", { class: "row", role: "group", "aria-label": t("masks_tools") }, ...this.tools), h("label", { class: "masks-size" }, t("masks_size"), this.radius), h("div", { class: "row push" }, this.undoButton, this.redoButton, button("zoom_out", () => this.sheet.setZoom(this.sheet.zoom / 1.5), { key: "-" }), button("zoom_in", () => this.sheet.setZoom(this.sheet.zoom * 1.5), { key: "+" }))),
      this.sheet.stage,
      h("div", { class: "masks-time" }, button("before", () => this.goTo(this.frame - 1), { key: "←" }), this.slider, button("after", () => this.goTo(this.frame + 1), { key: "→" }), this.nextButton),
      this.strip.element,
      h("div", { class: "row masks-foot" }, this.now, this.left),
      h("p", { class: "note" }, t("masks_hint")),
    );
    $("#masks-actions").replaceChildren(
      h("button", { type: "button", id: "masks-estimate", class: "primary", disabled: !this.state.cameras, onclick: () => this.estimate() }, icon("play"), t("masks_estimate")),
      h("a", { class: "button", id: "masks-save", href: `/api/masks/${this.id}/masks.npz`, download: "masks.npz" }, icon("download"), t("masks_save")),
      ...(this.of ? [h("button", { type: "button", class: "quiet", onclick: () => this.onJob(this.of) }, t("masks_back"))] : []),
    );
    if (!this.state.cameras) $("#masks-problem").replaceChildren(h("p", { class: "problem-box" }, t("masks_no_cameras")));
    this.setTool(this.tool);
    this.setRadius(Math.max(3, Math.round(Math.max(views[0].width, views[0].height) / 60)));
  }

  async loadOverlaps() {
    for (let next = 0, more = true; more; ) {
      const came = await get(`/estimations/${this.of}/frames`, { from: next });
      for (const [row, frame] of came.frames.entries()) this.overlaps.set(frame, came.overlap[row]);
      more = came.frames.length > 0 && came.next > next;
      next = came.next;
    }
    this.take(this.state);
  }

  take(state) {
    this.state = state;
    this.undoButton.disabled = !state.done;
    this.redoButton.disabled = !state.undone;
    this.doubts = state.views.map((_, view) => {
      const found = new Map(state.doubts[view]);
      const repaired = new Set(state.repaired[view]);
      for (const [frame, overlaps] of this.overlaps) {
        const overlap = overlaps[view];
        if (overlap !== null && overlap < UNSURE && !repaired.has(frame) && !found.has(frame)) found.set(frame, "overlap");
      }
      return found;
    });
    this.strip.set(state.n_frames, state.views.map((_, view) => ({ doubts: [...this.doubts[view].keys()], repaired: state.repaired[view] })));
    const count = this.list().length;
    this.left.textContent = t(count ? "masks_left" : "masks_none_left", { count, repaired: state.repaired.reduce((sum, frames) => sum + frames.length, 0) });
    this.nextButton.disabled = !count;
  }

  /** Doubtful frames in their order: {frame, view} */
  list() {
    return this.doubts.flatMap((found, view) => [...found.keys()].map((frame) => ({ frame, view }))).sort((a, b) => a.frame - b.frame || a.view - b.view);
  }

  goDoubtful(way) {
    const all = this.list();
    if (!all.length) return;
    const place = ({ frame, view }) => frame * this.state.views.length + view;
    const here = place(this);
    const next = way > 0 ? (all.find((one) => place(one) > here) ?? all[0]) : (all.findLast((one) => place(one) < here) ?? all.at(-1));
    this.goTo(next.frame, next.view);
  }

  goTo(frame, view = this.view) {
    this.frame = Math.min(Math.max(frame, 0), this.state.n_frames - 1);
    this.view = view;
    this.slider.value = String(this.frame);
    this.strip.point(this.view, this.frame);
    for (const [index, tab] of this.tabs.entries()) tab.setAttribute("aria-pressed", String(index === view));
    this.say();
    this.load();
  }

  say() {
    const { name } = this.state.views[this.view];
    const reason = this.doubts[this.view].get(this.frame);
    const words = t("masks_now", { view: name, frame: this.frame + 1, total: this.state.n_frames, seconds: formatSeconds(this.frame / this.state.frame_rate) });
    this.now.textContent = words + (reason ? t("masks_doubt", { reason: t(`masks_doubt_${reason}`) }) : "");
    this.slider.setAttribute("aria-valuetext", words);
  }

  // One at a time: whoever scrubs faster than silhouettes come sees fewer of them, not old ones.
  async load() {
    this.wanted = `${this.view}/${this.frame}?v=${this.version}`;
    if (this.busy) return;
    this.busy = true;
    while (this.wanted) {
      const [key, view, frame] = [this.wanted, this.view, this.frame];
      const { width, height, pictures, name } = this.state.views[view];
      const mask = await decode(`/api/masks/${this.id}/mask/${key}`);
      if (this.ended) return;
      if (this.wanted === key) this.wanted = null;
      if (this.wanted || this.sheet.points) continue; // something newer is asked for, or drawn over this one
      if (this.shownView !== view) this.sheet.setSize(width, height);
      this.shownView = view;
      this.sheet.show(mask, pictures ? `/api/masks/${this.id}/picture/${view}/${frame}` : null, t("masks_picture", { view: name, frame: frame + 1 }));
      this.sheet.stage.dataset.shown = key;
    }
    this.busy = false;
  }

  setTool(tool) {
    this.tool = tool;
    for (const one of this.tools) one.setAttribute("aria-pressed", String(one.dataset.tool === tool));
    this.sheet.stage.dataset.tool = tool;
  }

  setRadius(radius) {
    this.sheet.radius = Math.min(Math.max(Math.round(radius), LEAST), MOST);
    this.radius.value = String(this.sheet.radius);
    this.radius.setAttribute("aria-valuetext", t("masks_pixels", { value: this.sheet.radius }));
  }

  repair(values) {
    this.send("repairs", { view: this.view, frame: this.frame, ...values });
  }

  send(what, value) {
    this.pending += 1;
    this.saving = this.saving.then(async () => {
      const answer = await attempt(() => post(`/masks/${this.id}/${what}`, value));
      this.pending -= 1;
      if (this.ended) return;
      this.version += 1;
      if (answer) {
        this.take(answer);
        const { view, frame, count } = answer.changed;
        if (what !== "repairs" && count === 1) [this.view, this.frame] = [view, frame]; // what was undone is seen
        $("#masks-desk").dataset.done = String(answer.done);
      }
      if (!this.pending) this.goTo(this.frame, this.view);
    });
  }

  async estimate() {
    await this.saving;
    await attempt(async () => {
      const { request } = await get(`/jobs/${this.id}`);
      const job = await post("/jobs/estimate", { ...request, masks: this.id });
      this.onJob(job.id);
    });
  }

  press(event) {
    if (!this.state || event.defaultPrevented || $("dialog[open]") || event.target.closest?.("input:not([type=range]), textarea, select")) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const held = event.ctrlKey || event.metaKey;
    const inSlider = event.target.matches?.("input[type=range]");
    const acts = held
      ? { z: () => (event.shiftKey ? this.redoButton : this.undoButton).click(), y: () => this.redoButton.click() }
      : {
          ...Object.fromEntries(Object.entries(TOOLS).map(([tool, letter]) => [letter, () => this.setTool(tool)])),
          n: () => this.goDoubtful(event.shiftKey ? -1 : 1),
          "[": () => this.setRadius(this.sheet.radius / 1.25 - 0.5),
          "]": () => this.setRadius(this.sheet.radius * 1.25 + 0.5),
          "+": () => this.sheet.setZoom(this.sheet.zoom * 1.5),
          "-": () => this.sheet.setZoom(this.sheet.zoom / 1.5),
          ...(inSlider ? {} : { ArrowLeft: () => this.goTo(this.frame - (event.shiftKey ? 10 : 1)), ArrowRight: () => this.goTo(this.frame + (event.shiftKey ? 10 : 1)) }),
          ...Object.fromEntries(this.state.views.slice(0, 9).map((_, view) => [String(view + 1), () => this.goTo(this.frame, view)])),
        };
    if (!acts[key] || event.altKey) return;
    event.preventDefault();
    acts[key]();
  }
}
