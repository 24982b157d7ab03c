// The report of an evaluation, live: its parts, the player, the panel to adjust, files to take away.

import { get, post, put } from "../core/api.js";
import { $, h, icon, language, t } from "../core/dom.js";
import { notify } from "../core/notices.js";
import { Adjust } from "./adjust.js";
import { Beside } from "./beside.js";
import { foldAnalysis, putParts } from "./parts.js";

// What the teacher says of a performance: kept as it is typed, printed, and in the report that is downloaded.
const SETTLE = 600; // ms without a key before it is kept

function putNotes(section, job, notes) {
  let kept = notes;
  let waiting = null;
  const state = h("span", { class: "note", role: "status" });
  const field = h("textarea", { id: "notes", rows: "3", maxlength: "20000", placeholder: t("notes_placeholder"), "aria-labelledby": "notes-title" });
  const printed = h("p", { class: "notes-said only-print", "aria-hidden": "true" }, notes);
  field.value = notes;
  const fit = () => {
    field.style.height = "auto";
    field.style.height = `${field.scrollHeight + 2}px`;
  };
  const keep = async () => {
    clearTimeout(waiting);
    const typed = field.value;
    if (typed === kept) return;
    try {
      await put(`/evaluations/${job}/notes`, { notes: typed });
      kept = typed;
      state.textContent = t("notes_kept");
    } catch (error) {
      state.textContent = t("notes_not_kept");
      notify(error.message, "problem");
    }
  };
  field.addEventListener("input", () => {
    printed.textContent = field.value;
    section.classList.toggle("is-empty", !field.value.trim());
    state.textContent = "";
    fit();
    clearTimeout(waiting);
    waiting = setTimeout(keep, SETTLE);
  });
  field.addEventListener("change", keep);
  section.classList.toggle("is-empty", !notes.trim());
  section.replaceChildren(h("div", { class: "title-row" }, h("h2", { id: "notes-title" }, t("notes")), state), field, printed);
  fit();
  return keep;
}

// Asking for what was changed: quickly while it changes, exactly when it rests; never two questions at once.
const REST = 450; // ms without a change before the exact answer is asked for

class Asking {
  constructor(path, { onAnswer, onProblem, onBusy }) {
    Object.assign(this, { path, onAnswer, onProblem, onBusy, wanted: null, busy: false, timer: 0, ended: false });
  }

  /** Something is being changed; `done`: it is let go. */
  change(values, done) {
    this.wanted = { ...values, precision: "quick" };
    this.latest = values;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.settle(), done ? REST : 2 * REST);
    this.run();
  }

  settle() {
    this.wanted = { ...this.latest, precision: "exact" };
    this.run();
  }

  async run() {
    if (this.busy || !this.wanted || this.ended) return;
    const asked = this.wanted;
    this.wanted = null;
    this.busy = true;
    this.onBusy(true);
    try {
      const answer = await post(this.path, asked);
      if (!this.ended) this.onAnswer({ ...answer, kept: asked.precision === "exact" });
    } catch (error) {
      // The exact question would be answered by the same words again.
      if (!this.ended && asked.precision === "quick") clearTimeout(this.timer);
      if (!this.ended) this.onProblem(error);
    }
    this.busy = false;
    this.onBusy(false);
    this.run();
  }

  end() {
    this.ended = true;
    clearTimeout(this.timer);
  }
}

const FILES = { "report.html": "report", "curves.csv": "curves", "events.csv": "events", "furi.txt": "furi", "weights.toml": "weights" };

const EXERCISE_FILES = { "exercise.html": "report", "repetitions.csv": "repetitions" };

export function downloadLinks({ id, request }) {
  const files = request.repetitions ? EXERCISE_FILES : FILES;
  return Object.entries(files).map(([file, word]) => h("a", { class: "button small", href: `/api/evaluations/${id}/${file}?language=${language}`, download: "", dataset: { file } }, icon("download"), t(`download_${word}`)));
}

export class Result {
  constructor(root) {
    this.root = root;
  }

  /** Show the evaluation of a job; onArrival() before it is drawn. -> whether it is there */
  async show(wanted, onArrival) {
    const job = wanted.id;
    this.clear();
    const mine = (this.turn = Symbol(job));
    if (wanted.request.repetitions) return this.showExercise(wanted, mine, onArrival);
    const answer = await get(`/evaluations/${job}/report`, { language });
    if (mine !== this.turn) return false;
    onArrival();
    this.root.innerHTML = answer.frame;
    putParts(this.root, answer.parts);
    this.keepNotes = putNotes($("[data-part='notes']", this.root), job, answer.notes);
    foldAnalysis(this.root);
    $("[data-part='files']", this.root).replaceChildren(h("span", { class: "row" }, ...downloadLinks(wanted)));
    this.data = answer.data;
    this.player = window.dousa.createPlayer($("#player", this.root), answer.player);
    this.report = window.dousa.bindReport(this.root, answer.data, this.player);
    this.adjust = new Adjust(answer.assessment, answer.data.segments, {
      onChange: (values, done) => this.asking.change({ ...values, language }, done),
      onSeek: (seconds) => this.seekReference(seconds),
    });
    this.asking = new Asking(`/evaluations/${job}/adjust`, {
      onAnswer: (now) => this.take(now),
      onProblem: (error) => this.adjust.refuse(error),
      onBusy: (busy) => this.root.setAttribute("aria-busy", String(busy)),
    });
    $("[data-part='facts']", this.root).after(this.adjust.element);
    this.beside = new Beside(this.root, job, this.player);
    this.showProgress(job, mine);
    this.endTime = this.player.onTime((seconds) => this.followPlayer(seconds));
    this.followPlayer(this.player.time);
    return true;
  }

  async showExercise(wanted, mine, onArrival) {
    const answer = await get(`/evaluations/${wanted.id}/exercise`, { language });
    if (mine !== this.turn) return false;
    onArrival();
    this.root.innerHTML = answer.markup;
    $("[data-part='files']", this.root).replaceChildren(h("span", { class: "row" }, ...downloadLinks(wanted)));
    this.player = window.dousa.createPlayer($("#player", this.root), answer.player);
    this.report = window.dousa.bindExercise(this.root, answer.data, this.player);
    return true;
  }

  async showProgress(job, mine) {
    const { progress } = await get(`/evaluations/${job}/progress`, { language });
    if (!progress || mine !== this.turn) return;
    const picture = h("img", { src: `/api/evaluations/${job}/progress.svg?language=${language}`, alt: progress.says, loading: "lazy" });
    const card = h("section", { id: "progress-over-time" }, h("h2", {}, t("over_time")), h("p", { class: "lead" }, t("over_time_hint")), h("div", { class: "card over-time" }, h("p", { class: "good" }, progress.says), picture));
    $("#analysis", this.root).before(card);
  }

  take(answer) {
    putParts(this.root, answer.parts);
    this.data = answer.data;
    if (answer.player) this.player.replace(answer.player);
    this.report.update(answer.data);
    this.adjust.take(answer);
  }

  followPlayer(seconds) {
    const { matched, step } = this.data;
    const there = matched[Math.min(Math.round(seconds / step), matched.length - 1)];
    if (there != null) this.adjust.cuts.setCursor(there);
  }

  /** The moment of the performance that resembles a moment of the reference. */
  seekReference(seconds) {
    const { matched, step } = this.data;
    let best = -1;
    matched.forEach((there, place) => {
      if (there !== null && (best < 0 || Math.abs(there - seconds) < Math.abs(matched[best] - seconds))) best = place;
    });
    if (best >= 0) this.player.seek(best * step);
  }

  clear() {
    this.turn = null;
    this.keepNotes?.();
    this.asking?.end();
    this.endTime?.();
    this.report?.unbind();
    this.adjust?.destroy();
    this.beside?.destroy();
    this.player?.destroy();
    Object.assign(this, { asking: null, keepNotes: null, endTime: null, report: null, adjust: null, beside: null, player: null });
    this.root.replaceChildren();
  }
}
