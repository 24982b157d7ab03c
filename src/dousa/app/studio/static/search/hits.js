// The ranked clips: small figures that move in step with the query.

import { postForBytes } from "../core/api.js";
import { baseName, h, t } from "../core/dom.js";
import { listReasons } from "./reasons.js";

const FULL = 2.2; // distance at which the bar of likeness is empty

export const nameOf = (hit) => baseName(hit.path);
const distanceOf = (hit) => hit.rank_distance ?? hit.distance;

const two = (value) => (value == null ? "–" : value.toFixed(2));

function describeDistance(hit) {
  return t("distance_title", { histogram: two(hit.distance), pose: two(hit.pose_distance), share: Math.round(100 * hit.leaf_share) });
}

export class Hits {
  /** tools: {onChoose(hit), explain() -> answer with reasons, onGo(start, end)} */
  constructor(list, clock, tools) {
    Object.assign(this, { list, clock, tools, cards: new Map(), figures: [] });
  }

  clear() {
    for (const figure of this.figures) figure.destroy();
    this.figures = [];
    this.cards.clear();
    this.list.replaceChildren();
  }

  draw(hits) {
    this.clear();
    const seen = [];
    const last = hits.findLastIndex((hit) => hit.alike !== false);
    for (const [place, hit] of hits.entries()) {
      if (place === last + 1) seen.push(h("li", { class: "alike-end" }, t(last < 0 ? "alike_none" : "alike_end")));
      const card = this.makeCard(hit);
      this.cards.set(hit.motion, card);
      seen.push(card);
    }
    this.list.replaceChildren(...seen);
    this.drawFigures(hits);
  }

  makeCard(hit) {
    const canvas = h("canvas", { class: "hit-figure", "aria-hidden": "true" });
    const open = h(
      "button",
      { type: "button", class: "hit-open", "aria-pressed": "false", onclick: () => this.tools.onChoose(hit) },
      h("span", { class: "hit-rank" }, String(hit.rank)),
      canvas,
      h("span", { class: "hit-category" }, hit.category),
      h("span", { class: "hit-name", title: hit.path }, nameOf(hit)),
    );
    const bar = h("span", { class: "track", "aria-hidden": "true" }, h("i", { style: { width: `${100 * Math.max(0, 1 - distanceOf(hit) / FULL)}%` } }));
    const measure = h("p", { class: "hit-distance", title: describeDistance(hit) }, bar, h("span", {}, t("distance"), " ", h("b", {}, two(distanceOf(hit)))));
    const mirrored = hit.mirrored ? h("span", { class: "badge" }, "⇄ ", t("mirrored")) : null;
    const card = h("li", { class: hit.alike === false ? "hit less" : "hit", title: hit.probability == null ? null : t("alike_title", { percent: Math.round(100 * hit.probability) }), dataset: { motion: hit.motion, rank: hit.rank } }, open, measure, mirrored, this.makeWhy(hit));
    return card;
  }

  makeWhy(hit) {
    const why = h("details", { class: "why" }, h("summary", {}, t("why_alike")));
    why.addEventListener("toggle", async () => {
      if (!why.open || why.children.length > 1) return;
      const place = why.appendChild(h("p", { class: "note" }, t("loading")));
      const answer = await this.tools.explain();
      const found = answer?.results.find((one) => one.motion === hit.motion);
      place.replaceWith(h("p", { class: "note" }, describeDistance(hit)), listReasons(found?.likeness?.reasons, this.tools.onGo));
    });
    return why;
  }

  async drawFigures(hits) {
    const ids = hits.map((hit) => hit.clip_id);
    if (!ids.length) return;
    const list = this.cards;
    const bytes = await postForBytes("/clips/thumbnails", { clips: ids });
    if (list !== this.cards) return;
    const size = bytes.byteLength / ids.length;
    hits.forEach((hit, place) => {
      const canvas = this.cards.get(hit.motion)?.querySelector("canvas");
      if (!canvas) return;
      this.figures.push(window.dousa.createMiniature(canvas, bytes.slice(place * size, (place + 1) * size), { clock: this.clock, tone: "reference" }));
    });
  }

  mark(motion) {
    for (const [name, card] of this.cards) {
      card.classList.toggle("chosen", name === motion);
      card.querySelector(".hit-open").setAttribute("aria-pressed", String(name === motion));
    }
  }
}
