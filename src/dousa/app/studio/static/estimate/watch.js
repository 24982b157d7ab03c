// An estimation while it runs and afterwards: views, figure and curve stand at one frame, which follows the newest.

import { get, post } from "../core/api.js";
import { $, decode, formatSeconds, h, icon, language, t } from "../core/dom.js";
import { finished, followJob, isActive, resumeJob, stopJob } from "../core/jobs.js";
import { attempt, notify } from "../core/notices.js";
import { FilmDesk } from "../film/desk.js";
import { Chart } from "./chart.js";
import { Figure } from "./figure.js";

// Silhouette and model of every view at one frame; a picture stays until the next one is there.
class Views {
  constructor(place, job, views) {
    this.job = job;
    this.wanted = null;
    this.cells = views.map((view, index) => new Cell(job, view, index));
    const columns = chooseColumns(views);
    place.style.setProperty("--columns", String(columns));
    place.style.setProperty("--highest", `${Math.floor(56 / Math.ceil(views.length / columns))}vh`);
    place.replaceChildren(...this.cells.map((cell) => cell.element));
  }

  /** known: {overlaps, lost, stage} of the frame; version: changes when its drawing does. */
  show(frame, known) {
    const version = `${known.stage}`;
    for (const [index, cell] of this.cells.entries()) cell.show(frame, version, known.overlaps[index], known.lost);
  }
}

/** Wide pictures two beside each other (three of six or nine), tall ones four. */
function chooseColumns(views) {
  const isTall = views[0].height > views[0].width;
  if (isTall || views.length === 1) return Math.min(views.length, 4);
  return views.length <= 4 || views.length % 3 ? 2 : 3;
}

class Cell {
  constructor(job, view, index) {
    Object.assign(this, { job, view, index, busy: false, next: null, shown: null });
    this.picture = h("div", { class: "picture", style: {} }, t("view_waiting"));
    this.picture.style.setProperty("--shape", `${view.width} / ${view.height}`);
    this.value = h("span", {});
    this.mark = h("span", { class: "lost-mark", hidden: true }, t("lost"));
    this.element = h("figure", { class: "view", dataset: { view: view.name } }, this.picture, this.mark, h("figcaption", {}, h("b", {}, view.name), this.value));
  }

  show(frame, version, overlap, lost) {
    const key = `${frame}.${version}`;
    this.next = key === this.shown ? null : { frame, version, key, overlap, lost };
    if (!this.busy && this.next) this.load();
  }

  // One picture at a time: whoever plays faster than pictures come sees fewer of them, not old ones.
  async load() {
    const { frame, version, key, overlap, lost } = this.next;
    this.next = null;
    this.busy = true;
    const said = overlap === null ? "-" : overlap.toFixed(2);
    const image = await decode(`/api/estimations/${this.job}/overlay/${this.index}/${frame}?stage=${version}`);
    // Where there is none the job was forgotten, or the studio is away: what is shown stays.
    if (image) {
      image.alt = t("view_picture", { name: this.view.name, frame: frame + 1, overlap: said });
      this.picture.replaceChildren(image);
      this.value.textContent = overlap === null ? t("no_image") : t("overlap_value", { value: said });
      this.mark.hidden = !lost;
      this.element.classList.toggle("lost", lost);
      this.element.dataset.frame = String(frame);
      this.shown = key;
    }
    this.busy = false;
    if (this.next) this.load();
  }
}

// What came out, how far to trust it, and where to go with it.
function showOutcome(job) {
  const result = job.result;
  const motion = encodeURIComponent(`job:${job.id}`);
  const trust = result.trust ?? "good"; // of an older studio nothing is known
  const weights = result.warning_weights ?? [];
  const says = result.warnings.map((text, at) => h("li", { class: weights[at] ?? "" }, weights[at] && weights[at] !== "good" ? h("b", { class: "weight" }, t(`weight_${weights[at]}`), " ") : null, text));
  const place = $("#outcome");
  const parts = [
    h("h2", { id: "outcome-title", class: `trust ${trust}` }, t(`outcome_title_${trust}`)),
    says.length ? h("p", { class: "note" }, t(`outcome_trust_${trust}`)) : null,
    h("ul", { class: "says" }, ...(says.length ? says : [h("li", { class: "good" }, t("outcome_good"))])),
    h("dl", { class: "outcome-facts" }, ...facts(result).flatMap(([name, value]) => [h("div", {}, h("dt", {}, name), h("dd", {}, value))])),
    h(
      "div",
      { class: "row" },
      h("a", { class: `button ${trust === "bad" ? "" : "primary"}`, id: "search-it", href: `/search?motion=${motion}` }, icon("search"), t("search_it")),
      h("a", { class: "button", id: "evaluate-it", href: `/evaluate?performance=${motion}` }, icon("mark"), t("evaluate_it")),
      h("button", { type: "button", id: "add-it", onclick: () => askAndAdd(job) }, icon("folder"), t("add_it")),
    ),
    h(
      "div",
      { class: "row" },
      ...result.files.map((name) => h("a", { class: "button small quiet", href: `/api/estimations/${job.id}/files/${name}`, download: name }, icon("download"), t(`file_${name}`))),
    ),
  ];
  place.replaceChildren(...parts.filter(Boolean));
  place.hidden = false;
}

function facts(result) {
  const overlap = result.iou.mean === null ? "-" : result.iou.mean.toFixed(2);
  const lost = result.lost_frames.length;
  return [
    [t("outcome_overlap"), overlap],
    [t("outcome_lost"), lost ? t("outcome_of", { count: lost, total: result.n_frames }) : t("outcome_none_lost")],
    [t("outcome_length"), t("outcome_length_value", { frames: result.n_frames, seconds: formatSeconds(result.n_frames / result.frame_rate) })],
    [t("outcome_body"), t("outcome_stature", { value: result.stature_m.toFixed(2) })],
    [t("outcome_speed"), t("outcome_speed_value", { value: result.frames_per_second.toFixed(result.frames_per_second < 10 ? 1 : 0) })],
  ];
}

function askAndAdd(job) {
  const name = h("input", { type: "text", name: "name", required: true, maxlength: "80", value: job.title.replace(/\.[^.]+( \+ \d+)?$/, "") || "estimated" });
  const category = h("input", { type: "text", name: "category", maxlength: "80" });
  const dialog = h(
    "dialog",
    { "aria-label": t("add_title") },
    h(
      "form",
      { method: "dialog" },
      h("h2", {}, t("add_title")),
      h("label", { class: "field" }, t("add_name"), name),
      h("label", { class: "field" }, t("add_category"), category),
      h("div", { class: "foot" }, h("button", { type: "button", onclick: () => dialog.close("cancel") }, t("cancel")), h("button", { class: "primary", value: "add" }, t("add_do"))),
    ),
  );
  dialog.addEventListener("close", () => {
    dialog.remove();
    if (dialog.returnValue === "add") attempt(() => add(job, name.value.trim(), category.value.trim()));
  });
  document.body.append(dialog);
  dialog.showModal();
}

async function add(job, name, category) {
  const asked = await post(`/estimations/${job.id}/add`, { name: name || "estimated", category: category || null });
  const done = await finished(asked.id);
  const report = done.result;
  const taken = report && report.added.length + report.replaced.length + report.unchanged.length + report.duplicates.length > 0;
  if (taken) notify(t("added", { name }));
  else notify(t("add_refused", { reason: done.problem ?? report?.skipped[0]?.reason ?? t(`state_${done.state}`) }), "problem");
}

const LOOK_EVERY = 350; // ms
const UNSURE = 0.7; // mean overlap of silhouette and model, below which a frame is marked

function describeStep(job) {
  if (job.state === "queued") return t("what_waiting");
  return job.what && job.total > 1 ? t("what_step", { what: job.what, done: job.done, total: job.total }) : job.what;
}

export class Watching {
  /** id: of the job that is shown */
  constructor(id, { startOver, onJob, onMasks }) {
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
