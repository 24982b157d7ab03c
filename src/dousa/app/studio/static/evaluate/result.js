// The report of an evaluation, live: its parts, the player, the panel to adjust, files to take away.

import { get } from "../core/api.js";
import { $, h, icon, language, t } from "../core/dom.js";
import { Adjust } from "./adjust.js";
import { Asking } from "./asking.js";
import { Beside } from "./beside.js";
import { foldAnalysis, foldForPhones } from "./fold.js";
import { putNotes } from "./notes.js";
import { putParts } from "./parts.js";

const FILES = { "report.html": "report", "curves.csv": "curves", "events.csv": "events", "furi.txt": "furi", "weights.toml": "weights" };

const EXERCISE_FILES = { "exercise.html": "report", "repetitions.csv": "repetitions" };

/** Links to the files of an evaluation, as somebody has adjusted it. */
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
    foldForPhones(this.root);
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

  /** The report of an exercise: nothing in it can be adjusted. */
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

  /** Below the worst moments, where there are earlier evaluations against the same reference. */
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
