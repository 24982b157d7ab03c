// One clip, large: the figure in the player, what is known of it, where to go with it.

import { get } from "../core/api.js";
import { openDialog } from "../core/dialog.js";
import { formatSeconds, h, icon, language, t } from "../core/dom.js";
import { attempt } from "../core/notices.js";
import { link, placesFor } from "./actions.js";
import { nameTag } from "./tags.js";

const calm = window.matchMedia("(prefers-reduced-motion: reduce)");

export class Look {
  constructor(act) {
    Object.assign(this, { act, clip: null, player: null, round: 0 });
    this.stage = h("div", { class: "detail-stage" });
    this.facts = h("div", { class: "detail-facts" });
    this.element = h("div", { class: "detail" }, this.stage, this.facts);
  }

  /** Show a clip; the figure stays as it is where only what is known of it has changed. */
  async show(clip) {
    const same = this.clip?.id === clip.id;
    this.clip = clip;
    this.facts.replaceChildren(...describe(clip, (name) => this.act(name, clip)));
    if (same && this.player) return;
    const mine = ++this.round;
    const data = await attempt(() => get("/motions/player", { motion: clip.motion, language }));
    if (mine !== this.round || !data) return;
    if (this.player) this.player.replace(data);
    else {
      this.player = window.dousa.createPlayer(this.stage, data);
      if (!calm.matches) this.player.play();
    }
    if (clip.kind !== "take") this.player.loop(0, this.player.duration);
  }

  destroy() {
    this.round += 1;
    this.player?.destroy();
    this.player = null;
  }
}

/** hooks: neighbour(clip, step) -> clip or undefined, relabel(clip), tags(clip), remove(clip), closed(clip) */
export function openDetail(first, hooks) {
  const look = new Look((name, clip) => {
    close();
    hooks[name](clip);
  });
  const show = (clip) => {
    dialog.setAttribute("aria-label", clip.name);
    dialog.querySelector("h2").textContent = clip.name;
    look.show(clip);
  };
  const step = (by) => {
    const next = hooks.neighbour(look.clip, by);
    if (next) show(next);
  };
  const turn = (name, by, sign) => h("button", { type: "button", class: "quiet icon", "aria-label": t(name), title: t(name), onclick: () => step(by) }, sign);
  const { dialog, close } = openDialog(first.name, look.element, {
    wide: true,
    onClose: () => {
      look.destroy();
      hooks.closed(look.clip);
    },
  });
  // The dialog itself has the focus at first, not the button that closes it: a space is for the player.
  dialog.tabIndex = -1;
  dialog.focus();
  dialog.addEventListener("keydown", (event) => {
    if (event.target.closest("button, summary, a, input, .dousa-player") || event.ctrlKey || event.metaKey || event.altKey) return;
    const acts = { ArrowLeft: () => step(-1), ArrowRight: () => step(1), " ": () => look.player?.toggle() };
    if (!(event.key in acts)) return;
    event.preventDefault();
    acts[event.key]();
  });
  dialog.querySelector(".dialog-head h2").after(h("span", { class: "row push" }, turn("previous", -1, "‹"), turn("next", 1, "›")));
  show(first);
}

function describe(clip, act) {
  const rows = [
    ["facet_category", clip.category ?? (clip.kind === "take" ? null : t("no_label"))],
    ["taken_for", clip.predicted_category],
    ["facet_performer", clip.performer],
    ["facet_length", `${formatSeconds(clip.duration)} · ${t("frames", { count: clip.n_frames, rate: round(clip.frame_rate) })}`],
    ["height", t("metres", { value: clip.height.toFixed(2) })],
    ["format", `${clip.format} · ${clip.joint_table}`],
    ["tags", clip.tags.map(nameTag).join(", ")],
    ["folder", clip.folder],
  ];
  const button = (name, shape, kind = "") => h("button", { type: "button", class: kind, onclick: () => act(name) }, icon(shape), t(name));
  const download = async () => (await import("../core/exporting.js")).openDownload({ motion: clip.motion }, t("export"));
  const file = h("button", { type: "button", dataset: { word: "export-one" }, onclick: download }, icon("download"), t("export"));
  return [
    h("div", { class: "row" }, h("span", { class: "badge" }, t(clip.kind === "take" ? "take" : "clip")), h("span", { class: "note" }, `#${clip.id}`)),
    h("dl", { class: "facts" }, ...rows.filter(([, value]) => value).flatMap(([name, value]) => [h("dt", {}, t(name)), h("dd", {}, value)])),
    clip.warnings.length ? h("details", {}, h("summary", {}, t("doubts", { count: clip.warnings.length })), h("ul", { class: "plain-list" }, ...clip.warnings.map((text) => h("li", {}, text)))) : null,
    h("details", {}, h("summary", {}, t("where_file")), h("p", { class: "note" }, clip.path)),
    h("div", { class: "row detail-acts" }, ...placesFor([clip]).map(link), file, button("relabel", "label"), button("tags", "tag"), button("remove", "trash", "danger")),
  ].filter(Boolean);
}

const round = (value) => String(Math.round(100 * value) / 100);
