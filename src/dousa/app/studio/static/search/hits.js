// The ranked clips: small figures that move in step with the query.

import { getFigures } from "../core/api.js";
import { baseName, formatSeconds, h, t } from "../core/dom.js";

// Where in takes something like the query happens.
const CLEAR = 0.3; // score below which a place is shown only to who asks, where the library has not learned what is alike
const isClear = (place) => place.alike ?? place.score >= CLEAR;

export function formatMoment(seconds) {
  const tenths = Math.round(10 * seconds);
  return `${Math.floor(tenths / 600)}:${String(Math.floor(tenths / 10) % 60).padStart(2, "0")}.${tenths % 10}`;
}

export function drawPlaces(element, places, onChoose) {
  element.hidden = false;
  const clear = places.filter(isClear);
  const others = places.filter((place) => !isClear(place));
  const row = (place) => {
    const when = `${formatMoment(place.start_s)} – ${formatMoment(place.end_s)}`;
    return h(
      "li",
      { class: "place", dataset: { at: String(place.start_s) } },
      h("button", { type: "button", class: "place-open", onclick: () => onChoose(place) }, h("b", {}, when), h("span", { class: "hit-name" }, baseName(place.take)), h("span", { class: "note" }, `${t("score")} ${place.score.toFixed(2)}`), h("span", { class: "note" }, t("tempo", { value: place.tempo.toFixed(1) })), place.mirrored ? h("span", { class: "badge" }, "⇄ ", t("mirrored")) : null),
      h("a", { href: `/takes?motion=${place.motion}&at_s=${place.start_s.toFixed(2)}` }, t("open_take")),
    );
  };
  const list = (some) => h("ol", { class: "places" }, ...some.map(row));
  const rest = others.length ? h("details", {}, h("summary", {}, t("places_others", { count: others.length })), list(others)) : null;
  element.replaceChildren(h("h2", {}, t("places")), clear.length ? list(clear) : h("p", { class: "note" }, t("places_none")), ...[rest].filter(Boolean));
}

// Reasons in words.
export function listReasons(reasons, onGo) {
  if (!reasons?.length) return h("p", { class: "note" }, t("why_nothing"));
  const item = (reason) =>
    h(
      "li",
      {},
      h("span", {}, reason.text),
      h("button", { type: "button", class: "small quiet", onclick: () => onGo(reason.start, reason.end), "aria-label": `${t("play")} ${formatSeconds(reason.start)}` }, "▶ ", formatSeconds(reason.start)),
    );
  return h("ol", { class: "reasons" }, ...reasons.map(item));
}

/** What is asked for once it is opened; load() -> its elements. */
export function openLater(word, load) {
  const why = h("details", { class: "why" }, h("summary", {}, t(word)));
  why.addEventListener("toggle", async () => {
    if (!why.open || why.children.length > 1) return;
    const place = why.appendChild(h("p", { class: "note" }, t("loading")));
    place.replaceWith(...(await load()));
  });
  return why;
}

export const nameOf = (hit) => baseName(hit.path);

export async function exportHits(hits) {
  const { openExport } = await import("../core/exporting.js");
  openExport([], hits.map((hit) => ({ id: hit.clip_id, name: nameOf(hit), note: hit.category })));
}

/** How alike each of the hits is, 0 to 1: never more than the one before it. */
function rateHits(hits) {
  let most = 1;
  return hits.map((hit) => (most = Math.min(most, Math.exp(-(hit.rank_distance ?? hit.distance)))));
}

const two = (value) => (value == null ? "–" : value.toFixed(2));

function describeDistance(hit) {
  return t("distance_title", { votes: two(hit.distance), pose: two(hit.pose_distance), share: Math.round(100 * hit.leaf_share) });
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
    const alike = rateHits(hits);
    const last = hits.findLastIndex((hit) => hit.alike !== false);
    for (const [place, hit] of hits.entries()) {
      if (place === last + 1) seen.push(h("li", { class: "alike-end" }, t(last < 0 ? "alike_none" : "alike_end")));
      const card = this.makeCard(hit, Math.round(100 * alike[place]));
      this.cards.set(hit.motion, card);
      seen.push(card);
    }
    this.list.replaceChildren(...seen);
    this.drawFigures(hits);
  }

  makeCard(hit, likeness) {
    const canvas = h("canvas", { class: "hit-figure", "aria-hidden": "true" });
    const open = h(
      "button",
      { type: "button", class: "hit-open", "aria-pressed": "false", onclick: () => this.tools.onChoose(hit) },
      h("span", { class: "hit-rank" }, String(hit.rank)),
      canvas,
      h("span", { class: "hit-category" }, hit.category),
      h("span", { class: "hit-name", title: hit.path }, nameOf(hit)),
    );
    const bar = h("span", { class: "track", "aria-hidden": "true" }, h("i", { style: { width: `${likeness}%` } }));
    const measure = h("p", { class: "hit-distance", title: describeDistance(hit) }, bar, h("span", {}, t("likeness"), " ", h("b", {}, `${likeness} %`)));
    const mirrored = hit.mirrored ? h("span", { class: "badge" }, "⇄ ", t("mirrored")) : null;
    const card = h("li", { class: hit.alike === false ? "hit less" : "hit", title: hit.probability == null ? null : t("alike_title", { percent: Math.round(100 * hit.probability) }), dataset: { motion: hit.motion, rank: hit.rank } }, open, measure, mirrored, this.makeWhy(hit));
    return card;
  }

  makeWhy(hit) {
    return openLater("why_alike", async () => {
      const found = (await this.tools.explain())?.results.find((one) => one.motion === hit.motion);
      return [h("p", { class: "note" }, describeDistance(hit)), listReasons(found?.likeness?.reasons, this.tools.onGo)];
    });
  }

  async drawFigures(hits) {
    const ids = hits.map((hit) => hit.clip_id);
    if (!ids.length) return;
    const figures = await getFigures(ids);
    hits.forEach((hit, place) => {
      const canvas = this.cards.get(hit.motion)?.querySelector("canvas");
      if (canvas && figures[place]) this.figures.push(window.dousa.createMiniature(canvas, figures[place], { clock: this.clock, tone: "reference" }));
    });
  }

  mark(motion) {
    for (const [name, card] of this.cards) {
      card.classList.toggle("chosen", name === motion);
      card.querySelector(".hit-open").setAttribute("aria-pressed", String(name === motion));
    }
  }
}
