// An estimation while it runs and afterwards: views, figure and curve stand at one frame, which follows the newest.

import { get, post } from "../core/api.js";
import { $, formatSeconds, h, icon, language, t } from "../core/dom.js";
import { FilmDesk } from "../film/desk.js";
import { followJob, isActive, resumeJob, stopJob } from "../core/jobs.js";
import { attempt } from "../core/notices.js";
import { Chart } from "./chart.js";
import { Figure } from "./figure.js";
import { showOutcome } from "./outcome.js";
import { Views } from "./views.js";

const LOOK_EVERY = 350; // ms
const UNSURE = 0.7; // mean overlap of silhouette and model, below which a frame is marked

/** What a job is doing. */
function describeStep(job) {
  if (job.state === "queued") return t("what_waiting");
  return job.what && job.total > 1 ? t("what_step", { what: job.what, done: job.done, total: job.total }) : job.what;
}

/** Show a job; -> function that ends the watching. */
export function watchEstimation(id, { startOver, onJob, onMasks }) {
  const watching = new Watching(id, startOver, onJob, onMasks);
  return () => watching.end();
}

class Watching {
  constructor(id, startOver, onJob, onMasks) {
    Object.assign(this, { id, startOver, onJob, onMasks, job: null, run: null, next: 0, frames: new Map(), total: 0, rate: 30, frame: -1, following: true, ended: false });
    this.views = null;
    this.desk = null; // of an estimation from films
    $(".watch-columns").hidden = true; // until it is known which it is
    this.chart = new Chart($("#chart"), (frame) => this.goTo(frame));
    this.figure = new Figure($("#figure"), (seconds) => this.onPlayer(seconds), () => this.onFigure());
    $("#views").replaceChildren();
    $("#outcome").hidden = true;
    $("#figure-waiting").hidden = false;
    $("#figure-waiting").textContent = t("figure_waiting");
    $("#watch-problem").replaceChildren();
    $("#watch-actions").replaceChildren();
    $("#watch-name").textContent = t("page_estimate");
    $("#watch-what").textContent = t("loading");
    $("#time-now").textContent = "";
    $("#follow").onclick = () => this.setFollowing(!this.following);
    $("#frame").oninput = (event) => this.goTo(Number(event.target.value));
    this.begin();
  }

  async begin() {
    try {
      this.showJob(await get(`/jobs/${this.id}`));
    } catch (error) {
      $("#watch-what").textContent = "";
      $("#watch-problem").replaceChildren(h("p", { class: "problem-box" }, error.message));
      $("#watch-actions").replaceChildren(h("button", { type: "button", onclick: this.startOver }, t("new_estimation")));
      return;
    }
    this.unfollow = followJob(this.id, (job) => this.showJob(job));
    this.look();
  }

  end() {
    this.ended = true;
    clearTimeout(this.timer);
    this.unfollow?.();
    this.figure.destroy();
    this.desk?.destroy();
  }

  // --- the job

  showJob(job) {
    if (this.ended) return;
    const before = this.job;
    this.job = job;
    $("#watch-name").textContent = job.title;
    const badge = $("#watch-state");
    badge.textContent = t(`state_${job.state}`);
    badge.className = `badge ${{ done: job.result?.trust ?? "good", failed: "bad", stopped: "unsure" }[job.state] ?? ""}`;
    this.showProgress();
    if (before?.state !== job.state) this.showActions();
    $("#watch-problem").replaceChildren(...(job.problem ? [h("p", { class: "problem-box" }, job.problem)] : []));
    $("#follow").hidden = !isActive(job);
    this.desk?.setJob(job, isActive(job));
    $(".watch-columns").hidden = Boolean(this.desk) || (job.state !== "running" && !this.total); // it ended before the first frame
    if (before && isActive(before) !== isActive(job)) this.look();
    if (job.state === "done") this.finish(before);
    else $("#outcome").hidden = true;
  }

  showProgress() {
    const { job } = this;
    const bar = $("#watch-bar");
    bar.hidden = job.state === "done";
    const tracking = !this.desk && (!isActive(job) || this.frames.size < this.total);
    const [done, total] = tracking ? [Math.max(this.frames.size, job.done), this.total] : [job.done, job.total];
    if (total > 1 && job.state !== "queued") Object.assign(bar, { max: total, value: Math.min(done, total) });
    else if (isActive(job)) bar.removeAttribute("value");
    const note = job.notes.length ? job.notes.at(-1) : "";
    const stopped = this.desk ? t("what_stopped_films") : this.total ? t("what_stopped", { done: this.frames.size, total: this.total }) : "";
    const step = isActive(job) ? describeStep(job) : job.state === "stopped" ? stopped : "";
    const text = [step, isActive(job) ? note : ""].filter(Boolean).join(". ");
    if ($("#watch-what").textContent !== text) $("#watch-what").textContent = text;
  }

  showActions() {
    const { job, id } = this;
    const act = (name, action, kind) => h("button", { type: "button", id: `watch-${name}`, class: kind, onclick: () => attempt(action) }, t(name));
    const buttons = [];
    if (isActive(job)) buttons.push(act("stop", () => stopJob(id), "danger"));
    if (job.state === "stopped" || job.state === "failed") buttons.push(act("resume", () => resumeJob(id), "primary"));
    if (!isActive(job)) buttons.push(h("button", { type: "button", id: "watch-new", onclick: this.startOver }, icon("upload"), t("new_estimation")));
    if (!isActive(job) && this.views) buttons.splice(-1, 0, act("repair", () => this.repairMasks(), ""));
    const had = $("#watch-actions").contains(document.activeElement);
    $("#watch-actions").replaceChildren(...buttons);
    if (had) buttons[0]?.focus();
  }

  /** The silhouettes that were fitted, to be repaired and fitted again. */
  async repairMasks() {
    const { request } = await get(`/jobs/${this.id}`);
    const id = request.masks ?? (await post("/jobs/masks", request)).id;
    this.onMasks(id, this.id);
  }

  async finish(before) {
    if (before?.state === "done") return;
    this.setFollowing(false);
    showOutcome(this.job);
    this.playWhenThere = Boolean(before && isActive(before)); // who has watched it grow sees it whole
    await this.look(); // the one under way may have begun before the last frames were written
    await this.look();
    if (!this.desk) this.showFigure(false);
  }

  // --- the frames

  async look() {
    clearTimeout(this.timer);
    if (this.ended || this.looking) return this.looking;
    this.looking = this.takeFrames();
    const more = await this.looking.catch(() => false); // the studio is away; the next look may find it again
    this.looking = null;
    if (this.ended) return;
    if (more || isActive(this.job)) this.timer = setTimeout(() => this.look(), more ? 0 : LOOK_EVERY);
  }

  async takeFrames() {
    const came = await get(`/estimations/${this.id}/frames`, { from: this.next });
    if (this.ended) return false;
    if (came.film) return this.takeFilm(came.film);
    if (came.run !== this.run && this.run !== null) return this.restart(came);
    this.run = came.run || null;
    if (came.total && !this.views) {
      this.views = new Views($("#views"), this.id, came.views);
      Object.assign(this, { total: came.total, rate: came.frame_rate });
      $("#frame").max = String(came.total - 1);
      $(".watch-columns").hidden = false;
      this.showActions();
    }
    this.next = came.next;
    for (const [index, frame] of came.frames.entries()) this.frames.set(frame, describe(came, index));
    if (came.frames.length) this.onNew(came);
    return came.frames.length > 0 && !isActive(this.job);
  }

  async takeFilm(version) {
    if (!this.desk) {
      this.desk = new FilmDesk(this.job, this.onJob);
      this.desk.setJob(this.job, isActive(this.job));
      $(".watch-columns").hidden = true;
    }
    await this.desk.refresh(version).catch(() => {}); // the studio is away; the next look may find it again
    return false;
  }

  // Taken up again or begun anew: what is known is asked for once more.
  restart(came) {
    Object.assign(this, { run: came.run || null, next: 0 });
    if (!came.total) this.frames.clear();
    return true;
  }

  onNew(came) {
    this.chart.draw(this.frames, this.total);
    this.showProgress();
    if (this.following || this.frame < 0) this.showFrame(came.finished - 1);
    else this.showFrame(this.frame);
    if (!came.is_person) $("#figure-waiting").textContent = t("figure_none");
    this.hasFigure = came.is_person && came.finished > 1;
    this.showFigure(true);
  }

  showFigure(live) {
    if (this.hasFigure) this.figure.refresh(`/estimations/${this.id}/player`, { language }, live);
  }

  onFigure() {
    $("#figure-waiting").hidden = true;
    if (this.playWhenThere) {
      this.playWhenThere = false;
      this.figure.playOnce();
    } else if (!this.figure.playing) this.figure.seek(Math.max(this.frame, 0) / this.rate);
  }

  // --- the moment

  setFollowing(following) {
    this.following = following;
    $("#follow").setAttribute("aria-pressed", String(following));
    if (following && this.frames.size) this.goTo(Math.max(...this.frames.keys()), true);
  }

  goTo(frame, following = false) {
    if (!following && this.following) this.setFollowing(false);
    const newest = this.frames.size ? Math.max(...this.frames.keys()) : 0;
    const inside = Math.min(frame, newest);
    this.showFrame(inside);
    this.figure.seek(inside / this.rate);
  }

  onPlayer(seconds) {
    const frame = Math.round(seconds * this.rate);
    if (this.following && this.figure.playing) this.setFollowing(false);
    if (!this.following && frame !== this.frame) this.showFrame(frame);
  }

  showFrame(frame) {
    const known = this.frames.get(frame);
    if (!known) return;
    this.frame = frame;
    this.views.show(frame, known);
    this.chart.point(frame);
    const slider = $("#frame");
    if (Number(slider.value) !== frame) slider.value = String(frame);
    const overlap = known.overlap === null ? "-" : known.overlap.toFixed(2);
    const words = { frame: frame + 1, total: this.total, seconds: formatSeconds(frame / this.rate), overlap };
    const text = t("time_now", words) + (known.lost ? `, ${t("lost")}` : known.unsure ? `, ${t("unsure")}` : "");
    $("#time-now").textContent = text;
    slider.setAttribute("aria-valuetext", text);
  }
}

function describe(came, index) {
  const overlaps = came.overlap[index];
  const seen = overlaps.filter((value) => value !== null);
  const overlap = seen.length ? seen.reduce((sum, value) => sum + value, 0) / seen.length : null;
  return { overlaps, overlap, lost: came.lost[index], unsure: overlap !== null && overlap < UNSURE, stage: came.stage[index] };
}
