// The query on the stage, alone or with a match beside it, over its timeline.

import { get } from "../core/api.js";
import { $, baseName, formatSeconds, h, icon, language, t } from "../core/dom.js";
import { Timeline } from "../core/timeline.js";
import { nameOf } from "./hits.js";
import { isSameMotion, queryOf, wholeOf } from "./state.js";

const [BAR, ENOUGH] = [64, 0.75]; // px that the bar of the page covers; share of the player that has to be seen
const calm = window.matchMedia("(prefers-reduced-motion: reduce)");

export class Stage {
  /** clock: of the small figures; onPart({start_s, end_s}), onAlone() when the match is put away. */
  constructor(clock, { onPart, onAlone }) {
    Object.assign(this, { clock, onPart, onAlone, shown: null, player: null, timeline: null, run: 0 });
    this.match = $("#match");
  }

  async show(state, hit, info) {
    const run = ++this.run;
    const fresh = !this.shown || !isSameMotion(this.shown, state);
    const data = await (state.hit ? get("/motions/pair", this.pairOf(state, hit)) : get("/motions/player", { ...wholeOf(state), language }));
    if (run !== this.run) return;
    Object.assign(this, { shown: { ...state }, offset: state.hit ? (state.start_s ?? 0) : 0 });
    if (fresh) this.describe(info);
    if (fresh) this.makeTimeline(info, state.start_s ?? 0);
    this.timeline.setSelection(state.start_s ?? (state.end_s === null ? null : 0), state.end_s ?? info.duration_s);
    this.play(data, fresh, state);
  }

  pairOf(state, hit) {
    return {
      ...queryOf(state),
      other: state.hit,
      other_start_s: state.other_start_s,
      other_end_s: state.other_end_s,
      mirror: hit?.mirrored ? "true" : null,
      language,
    };
  }

  describe(info) {
    $("#stage-name").textContent = info.name;
    $("#stage-name").title = info.path ?? info.name;
    const notes = info.notes.length ? h("details", { class: "doubts" }, h("summary", {}, t("doubts")), h("ul", {}, ...info.notes.map((note) => h("li", { class: "note" }, note)))) : null;
    const category = info.category ? h("span", { class: "badge" }, info.category) : null;
    $("#stage-tools").replaceChildren(...[category, h("span", { class: "note" }, formatSeconds(info.duration_s)), notes].filter(Boolean));
    document.title = `${info.name} - ${t("page_search")} - dousa`;
  }

  makeTimeline(info, from) {
    this.timeline?.destroy();
    const onSeek = (seconds) => {
      this.player?.pause();
      this.player?.seek(seconds - this.offset);
    };
    const onSelect = (part, done) => done && this.onPart({ start_s: part?.start ?? null, end_s: part?.end ?? null });
    this.timeline = new Timeline($("#timeline"), { duration: info.duration_s, selectable: true, label: t("query"), onSeek, onSelect, onSpace: () => this.player?.toggle() });
    if (info.kind === "take") this.timeline.showPart(from);
  }

  play(data, fresh, state) {
    const running = this.player ? this.player.playing : false;
    if (this.player) this.player.replace(data);
    else this.makePlayer(data);
    const { player } = this;
    const [start, end] = state.hit ? [0, player.duration] : [state.start_s ?? 0, state.end_s ?? player.duration];
    this.looped = [start, Math.min(end, player.duration)];
    player.loop(...this.looped);
    if (fresh || player.time < start || player.time > end || this.wasPair !== Boolean(state.hit)) player.seek(start);
    this.wasPair = Boolean(state.hit);
    if ((fresh || running || state.hit) && !calm.matches) player.play();
    this.follow(player.time);
  }

  makePlayer(data) {
    this.player = window.dousa.createPlayer($("#player"), data);
    this.player.onTime((time) => this.follow(time));
  }

  /** The cursor and the small figures go with the player. */
  follow(time) {
    const [start, end] = this.looped ?? [0, this.player.duration];
    this.timeline?.setCursor(time + this.offset);
    this.clock.seek((time - start) / Math.max(end - start, 1e-3));
  }

  reveal() {
    const { top, bottom, height } = $("#player").getBoundingClientRect();
    const seen = Math.min(bottom, window.innerHeight) - Math.max(top, BAR);
    if (seen >= ENOUGH * height) return;
    $(".stage").scrollIntoView({ block: "start", behavior: calm.matches ? "auto" : "smooth" });
  }

  leave() {
    this.run += 1;
    this.player?.pause();
  }

  go(start, end) {
    this.reveal();
    const shift = this.wasPair ? 0 : (this.shown.start_s ?? 0);
    this.player.loop(start + shift, Math.min(end + shift, this.player.duration));
    this.looped = [start + shift, Math.min(end + shift, this.player.duration)];
    this.player.seek(start + shift);
    this.player.play();
  }

  describeMatch(state, hit, actions) {
    this.match.hidden = !state.hit;
    $("#stage-kind").textContent = state.hit ? t("pair") : t("query");
    if (!state.hit) return;
    const part = { motion: state.hit, start_s: state.other_start_s, end_s: state.other_end_s };
    const asked = new URLSearchParams(Object.entries(part).filter(([, value]) => value !== null));
    const performance = { performance: state.motion, references: state.hit, start_s: state.start_s, end_s: state.end_s };
    const judged = new URLSearchParams(Object.entries(performance).filter(([, value]) => value !== null));
    const when = state.other_start_s === null ? null : `${formatSeconds(state.other_start_s)} – ${formatSeconds(state.other_end_s ?? 0)}`;
    const facts = [hit?.category && !when ? h("span", { class: "badge" }, hit.category) : null, h("b", { class: "hit-name" }, hit ? (hit.take ? baseName(hit.take) : nameOf(hit)) : state.hit), when ? h("span", {}, when) : null, hit?.mirrored ? h("span", { class: "badge" }, "⇄ ", t("mirrored")) : null];
    const link = (href, word, shape, extra = {}) => h("a", { class: "button small", href, ...extra }, shape ? icon(shape) : null, t(word));
    const id = state.hit.replace("clip:", "");
    this.match.replaceChildren(
      h("div", { class: "row" }, ...facts.filter(Boolean)),
      h(
        "div",
        { class: "row" },
        link(`/api/motions/file?${asked}`, "download_bvh", "download", { download: "", id: "download" }),
        h("button", { type: "button", class: "small", id: "onto", onclick: async () => (await import("../core/exporting.js")).openDownload(part) }, icon("download"), t("onto_character")),
        h("button", { type: "button", class: "small", id: "search-with", onclick: () => actions.searchWith(part) }, icon("search"), t("search_with")),
        link(`/evaluate?${judged}`, "evaluate_against", "mark"),
        when ? link(`/takes?motion=${state.hit}&at_s=${state.other_start_s}`, "open_take") : link(`/library?clip=${id}`, "show_in_library"),
        h("button", { type: "button", class: "small quiet", id: "alone", onclick: () => this.onAlone() }, t("back_to_query")),
      ),
    );
  }
}
