// One report to look at: advice, player and worst moments first; the analysis is folded.

import { get } from "../core/api.js";
import { $, h, language, t } from "../core/dom.js";
import { foldAnalysis, foldForPhones } from "../evaluate/fold.js";
import { putParts } from "../evaluate/parts.js";

export class Report {
  constructor(root) {
    this.root = root;
  }

  /** Show an evaluation, or one of an exercise. */
  async show(id, repetitions) {
    const answer = await get(`/reports/${id}${repetitions ? "/exercise" : ""}`, { language });
    const { root } = this;
    root.hidden = false; // what is drawn needs its place on the page first
    root.innerHTML = repetitions ? answer.markup : answer.frame;
    if (!repetitions) {
      putParts(root, answer.parts);
      this.sayNotes(answer.notes);
      foldAnalysis(root);
      foldForPhones(root);
    }
    $("[data-part='files']", root)?.replaceChildren();
    this.player = window.dousa.createPlayer($("#player", root), answer.player);
    if (repetitions) window.dousa.bindExercise(root, answer.data, this.player);
    else window.dousa.bindReport(root, answer.data, this.player);
  }

  sayNotes(notes) {
    const section = $("[data-part='notes']", this.root);
    if (!notes.trim()) section.remove();
    else section.replaceChildren(h("h2", {}, t("notes")), h("div", { class: "card" }, h("p", { class: "notes-said" }, notes)));
  }
}
