// The desk of an estimation from films: all films at one moment, the people in them, the cameras, the motion.

import { get, post } from "../core/api.js";
import { $, formatSeconds, language, t } from "../core/dom.js";
import { attempt } from "../core/notices.js";
import { Chart } from "../estimate/chart.js";
import { Figure } from "../estimate/figure.js";
import { FilmView } from "./film_view.js";
import { Choice, colourOf, showPeople } from "./people.js";
import { Space } from "./space.js";

const MOST_DOUBT = 200; // mm, the top of the curve
const TOGETHER = 0.6; // frames by which films may start apart and be called together

export class FilmDesk {
  /** job: of the estimation; onJob(id) when another was started with other people. */
  constructor(job, onJob) {
    Object.assign(this, { id: job.id, job, onJob, film: null, version: 0, frame: 0, large: null, model: true, keypoints: true, views: [] });
    this.choice = new Choice();
    this.chart = new Chart($("#film-chart"), (frame) => this.goTo(frame), { labels: ["20 cm", "10", "0"], worst: Math.max });
    this.figure = new Figure($("#film-figure"), (seconds) => this.onPlayer(seconds), () => this.onFigure());
    this.space = new Space($("#film-space"), $("#film-cameras"), (index) => this.views[index]?.loaded ?? null);
    $("#film-frame").oninput = (event) => this.goTo(Number(event.target.value));
    $("#film-play").onclick = () => this.setPlaying(!this.playing);
    $("#film-model").onclick = () => this.toggle("model");
    $("#film-keypoints").onclick = () => this.toggle("keypoints");
    this.onKey = (event) => event.key === "Escape" && this.large !== null && this.enlarge(null);
    document.addEventListener("keydown", this.onKey);
    $("#film").hidden = false;
  }

  destroy() {
    this.ended = true;
    this.setPlaying(false);
    document.removeEventListener("keydown", this.onKey);
    for (const view of this.views) view.destroy();
    this.figure.destroy();
    this.space.destroy();
    $("#film-views").replaceChildren();
    $("#film-people").replaceChildren();
    $("#film").hidden = true;
  }

  setJob(job, active) {
    Object.assign(this, { job, active });
    if (this.film) this.drawPeople();
  }

  async refresh(version) {
    if (version === this.version) return;
    const film = await get(`/estimations/${this.id}/film`);
    if (this.ended || film.version === this.version) return;
    this.version = film.version;
    this.film = film;
    this.choice.update(film);
    if (!this.views.length) this.buildViews();
    for (const view of this.views) view.update(film);
    this.enlarge(this.large);
    $("#film-frame").max = String(Math.max(film.total - 1, 0));
    for (const button of [$("#film-model"), $("#film-time .chart")]) button.hidden = film.stage !== "fitted";
    $("#film-keypoints").hidden = film.stage === "films";
    $("#film-chart-legend").hidden = film.stage !== "fitted";
    this.describeStarts();
    this.drawPeople();
    await this.showMotion();
    this.showFrame(Math.min(this.frame, film.total - 1));
  }

  buildViews() {
    const on = { enlarge: (index) => this.enlarge(this.large === index ? null : index), ...this.choosing() };
    this.views = this.film.views.map((_, index) => new FilmView(this, index, on));
    $("#film-views").classList.toggle("few", this.views.length < 3);
    $("#film-views").replaceChildren(...this.views.map((view) => view.element));
  }

  describeStarts() {
    const { starts, views, frame_rate: rate } = this.film;
    const place = $("#film-starts");
    for (const [index, view] of this.views.entries()) view.starts.textContent = starts && Math.max(...starts) > TOGETHER / rate ? t(starts[index] ? "starts_short" : "starts_first", { seconds: starts[index].toFixed(2) }) : "";
    if (!starts || views.length < 2) {
      place.textContent = views.length < 2 ? "" : t("starts_unknown");
      return;
    }
    if (Math.max(...starts) <= TOGETHER / rate) {
      place.textContent = t("starts_together");
      return;
    }
    const first = views[starts.indexOf(0)]?.name ?? views[0].name;
    const later = views.flatMap((view, index) => (starts[index] ? [t("starts_later", { name: view.name, seconds: starts[index].toFixed(2) })] : []));
    place.textContent = t("starts", { first, later: later.join(t("starts_and")) });
  }

  async showMotion() {
    const { film } = this;
    let joints = null;
    if (film.stage === "fitted") {
      joints = await this.loadJoints();
      const [lost, unsure] = [new Set(film.lost), new Set(film.unsure)];
      const rows = film.doubt_mm.map((doubt, frame) => [frame, { overlap: Math.min(doubt / MOST_DOUBT, 1), lost: lost.has(frame), unsure: unsure.has(frame), stage: 2 }]);
      Object.assign(this, { lost, unsure });
      this.chart.draw(new Map(rows), film.total);
      this.figure.refresh(`/estimations/${this.id}/player`, { language }, false);
    }
    $("#film-space-card").hidden = !film.cameras.length;
    $("#film-figure-card").hidden = film.stage !== "fitted";
    this.space.set(film.cameras, joints, film.parents, colourOf(film.chosen));
  }

  async loadJoints() {
    const joints = new Float32Array(60 * this.film.total).fill(NaN);
    for (let next = 0, more = true; more; ) {
      const came = await get(`/estimations/${this.id}/frames`, { from: next, joints: true });
      const raw = Uint8Array.from(atob(came.joints), (letter) => letter.charCodeAt(0));
      const values = new Float32Array(raw.buffer);
      for (const [row, frame] of came.frames.entries()) if (frame < this.film.total) joints.set(values.subarray(60 * row, 60 * row + 60), 60 * frame);
      more = came.frames.length > 0 && came.next > next;
      next = came.next;
    }
    return joints;
  }

  onFigure() {
    $("#film-figure-waiting").hidden = true;
    this.figure.seek(this.frame / this.film.frame_rate);
  }

  drawPeople() {
    const on = { ...this.choosing(), fit: () => attempt(() => this.fitAgain()), undo: this.then((choice) => choice.reset()) };
    showPeople($("#film-people"), this.choice, Boolean(this.active), on);
  }

  then(change) {
    return (...values) => {
      change(this.choice, ...values);
      this.redraw();
    };
  }

  choosing() {
    return {
      pick: this.then((choice, person) => choice.pick(person)),
      toggle: this.then((choice, view, track) => choice.toggle(view, track)),
      same: this.then((choice, view, track) => choice.add(view, track)),
    };
  }

  /** A film shows another picture: so does its place in space. */
  onPicture() {
    if (!this.ended) this.space.draw();
  }

  redraw() {
    this.drawPeople();
    for (const view of this.views) view.draw();
  }

  async fitAgain() {
    const { request } = await get(`/jobs/${this.id}`);
    const job = await post("/jobs/estimate", { ...request, ...this.choice.request() });
    this.onJob(job.id);
  }

  toggle(what) {
    this[what] = !this[what];
    $(`#film-${what}`).setAttribute("aria-pressed", String(this[what]));
    this.showFrame(this.frame);
  }

  enlarge(index) {
    this.large = index;
    $("#film-views").classList.toggle("one", index !== null);
    for (const [own, view] of this.views.entries()) view.setLarge(own === index);
  }

  goTo(frame) {
    if (!this.film) return;
    this.showFrame(frame);
    this.figure.seek(frame / this.film.frame_rate);
  }

  onPlayer(seconds) {
    const frame = Math.min(Math.round(seconds * this.film.frame_rate), this.film.total - 1);
    if (frame !== this.frame && !this.playing) this.showFrame(frame);
  }

  setPlaying(playing) {
    this.playing = playing;
    $("#film-play").textContent = t(playing ? "film_pause" : "film_play");
    cancelAnimationFrame(this.waiting);
    if (!playing || !this.film) return;
    const start = performance.now() - ((this.frame + 1 >= this.film.total ? 0 : this.frame) * 1000) / this.film.frame_rate;
    const tick = () => {
      const frame = Math.floor(((performance.now() - start) * this.film.frame_rate) / 1000);
      if (frame >= this.film.total) return this.setPlaying(false);
      if (frame !== this.frame) this.goTo(frame);
      this.waiting = requestAnimationFrame(tick);
    };
    tick();
  }

  showFrame(frame) {
    const { film } = this;
    if (!film || !film.total) return;
    this.frame = Math.max(frame, 0);
    const state = this.lost?.has(frame) ? "lost" : this.unsure?.has(frame) ? "unsure" : "";
    for (const view of this.views) view.show(this.frame, state);
    this.space.show(this.frame);
    this.chart.point(this.frame);
    const slider = $("#film-frame");
    if (Number(slider.value) !== this.frame) slider.value = String(this.frame);
    const text = t("film_now", { frame: this.frame + 1, total: film.total, seconds: formatSeconds(this.frame / film.frame_rate) }) + (state ? `, ${t(state)}` : "");
    $("#film-now").textContent = text;
    slider.setAttribute("aria-valuetext", text);
  }
}
