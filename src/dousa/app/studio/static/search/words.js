// Searching in words: a box, and below it the clips and takes that fit; choosing one searches with it.

import { post } from "../core/api.js";
import { baseName, h, t } from "../core/dom.js";
import { spellingButton } from "../core/spelling.js";
import { exportHits, formatMoment } from "./hits.js";

const FIRST = 24;

export class Words {
  /** tools: {onAsk(text) keeps the text in the address, onChoose(hit, {start_s, end_s} of a part of a take)} */
  constructor(form, place, tools) {
    Object.assign(this, { form, place, tools, asked: null, asking: null, left: null });
    this.input = form.querySelector("input");
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      tools.onAsk(this.input.value.trim() || null);
    });
  }

  async show(text) {
    if (text === this.asked) return;
    this.asked = text;
    this.input.value = text ?? "";
    const left = this.left; // where a hit was chosen: the list is found again as it was
    if (!text) {
      this.clear();
      return;
    }
    this.left = null;
    await this.ask(text, left?.text === text ? left.k : FIRST);
    if (left?.text === text && this.asked === text) this.returnTo(left);
  }

  returnTo({ top, place }) {
    const list = this.place.querySelector(".word-hits");
    if (!list) return;
    list.scrollTop = top;
    list.children[place]?.querySelector("button").focus({ preventScroll: true });
  }

  choose(hit, part, { currentTarget }) {
    const list = this.place.querySelector(".word-hits");
    this.left = { text: this.asked, k: this.k, top: list.scrollTop, place: [...list.children].indexOf(currentTarget.closest("li")) };
    this.tools.onChoose(hit, part);
  }

  clear() {
    this.asking?.abort();
    this.place.hidden = true;
    this.place.replaceChildren();
  }

  async ask(text, k) {
    this.asking?.abort();
    const mine = (this.asking = new AbortController());
    this.k = k;
    this.place.hidden = false;
    this.place.replaceChildren(h("p", { class: "note" }, t("searching")));
    try {
      const answer = await post("/search/text", { text, k }, mine.signal);
      if (mine === this.asking) this.draw(answer);
    } catch (error) {
      if (mine === this.asking && error.name !== "AbortError") this.place.replaceChildren(h("p", { class: "problem-box", role: "alert" }, error.message));
    }
  }

  draw(answer) {
    const taken = Object.entries({ ...answer.corrections, ...answer.replaced }).map(([word, other]) => h("p", { class: "note" }, t("words_taken", { word, taken: other })));
    const count = t(answer.n_found ? "words_count" : "words_none", { count: answer.n_found, all: answer.n_searched });
    const close = h("button", { type: "button", class: "small", onclick: () => this.tools.onAsk(null) }, t("words_close"));
    const spelled = spellingButton(() => post("/spelling/search/text", { text: this.asked, k: this.k }));
    const along = answer.n_found ? h("button", { type: "button", class: "small", id: "export-words", onclick: () => exportHits(answer.results) }, t("export_hits_button")) : "";
    const parts = [h("div", { class: "results-head" }, h("h2", {}, t("words_title")), h("p", { class: "note", role: "status" }, count), spelled, along, close), ...taken];
    if (!answer.n_found && answer.unknown_words.length) parts.push(h("p", { class: "note" }, t("words_unknown", { words: answer.unknown_words.join(", ") })));
    if (answer.near_words.length) parts.push(h("p", { class: "row" }, t("words_near"), ...answer.near_words.map((word) => h("button", { type: "button", class: "small", onclick: () => this.tools.onAsk(word) }, word))));
    parts.push(h("ol", { class: "word-hits" }, ...answer.results.map((hit) => this.drawHit(hit))));
    if (answer.n_found > answer.results.length) parts.push(h("button", { type: "button", class: "small", onclick: () => this.ask(answer.text, Math.min(1000, answer.n_found)) }, t("words_more", { count: answer.n_found })));
    this.place.replaceChildren(...parts);
  }

  /** Of a take its parts lead to themselves: the first with the hit, each further one by a button of its own. */
  drawHit(hit) {
    const isTake = hit.kind === "take";
    const [shown, others] = isTake ? [hit.relations.slice(0, 1), hit.relations.slice(1)] : [hit.relations, []];
    const open = (one, kind, ...parts) => h("button", { type: "button", class: kind, onclick: (event) => this.choose(hit, one && isTake ? { start_s: one.start_s, end_s: one.end_s } : null, event) }, ...parts);
    const does = (one) => [isTake ? h("b", {}, `${formatMoment(one.start_s)} – ${formatMoment(one.end_s)}`) : null, h("span", { class: "badge" }, one.text)];
    const head = [h("b", {}, hit.category ?? (isTake ? t("take") : "–")), h("span", { class: "hit-name", title: hit.path }, baseName(hit.path))];
    const fits = h("span", { class: "note" }, t("words_fits", { percent: Math.round(100 * hit.score) }));
    return h("li", {}, open(shown[0], "word-hit", ...head, ...shown.flatMap(does), fits), ...others.map((one) => open(one, "word-hit word-part", ...does(one))));
  }
}
