// One clip, large: the figure in the player, what is known of it, where to go with it.

import { get } from "../core/api.js";
import { openDialog } from "../core/dialog.js";
import { formatSeconds, h, icon, language, t } from "../core/dom.js";
import { attempt } from "../core/notices.js";
import { link, placesFor } from "./actions.js";

const calm = window.matchMedia("(prefers-reduced-motion: reduce)");

/** hooks: neighbour(clip, step) -> clip or undefined, relabel(clip), remove(clip), closed(clip) */
export function openDetail(first, hooks) {
  let [clip, player, round] = [first, null, 0];
  const stage = h("div", { class: "detail-stage" });
  const facts = h("div", { class: "detail-facts" });
  const step = (by) => {
    const next = hooks.neighbour(clip, by);
    if (next) show(next);
  };
  const show = async (wanted) => {
    clip = wanted;
    const mine = ++round;
    facts.replaceChildren(...describe(clip, act));
    dialog.setAttribute("aria-label", clip.name);
    dialog.querySelector("h2").textContent = clip.name;
    const data = await attempt(() => get("/motions/player", { motion: clip.motion, language }));
    if (mine !== round || !data) return;
    if (player) player.replace(data);
    else {
      player = window.dousa.createPlayer(stage, data);
      if (!calm.matches) player.play();
    }
    if (clip.kind !== "take") player.loop(0, player.duration);
  };
  const act = (name) => {
    close();
    hooks[name](clip);
  };
  const turn = (name, by, sign) => h("button", { type: "button", class: "quiet icon", "aria-label": t(name), title: t(name), onclick: () => step(by) }, sign);
  const { dialog, close } = openDialog(first.name, h("div", { class: "detail" }, stage, facts), {
    wide: true,
    onClose: () => {
      player?.destroy();
      hooks.closed(clip);
    },
  });
  // The dialog itself has the focus at first, not the button that closes it: a space is for the player.
  dialog.tabIndex = -1;
  dialog.focus();
  dialog.addEventListener("keydown", (event) => {
    if (event.target.closest("button, summary, a, input, .dousa-player") || event.ctrlKey || event.metaKey || event.altKey) return;
    const acts = { ArrowLeft: () => step(-1), ArrowRight: () => step(1), " ": () => (player?.playing ? player.pause() : player?.play()) };
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
    ["folder", clip.folder],
  ];
  const button = (name, shape, kind = "") => h("button", { type: "button", class: kind, onclick: () => act(name) }, icon(shape), t(name));
  const download = async () => (await import("../core/exporting.js")).openDownload({ motion: clip.motion }, t("export"));
  const file = h("button", { type: "button", dataset: { word: "export" }, onclick: download }, icon("download"), t("export"));
  return [
    h("div", { class: "row" }, h("span", { class: "badge" }, t(clip.kind === "take" ? "take" : "clip")), h("span", { class: "note" }, `#${clip.id}`)),
    h("dl", { class: "facts" }, ...rows.filter(([, value]) => value).flatMap(([name, value]) => [h("dt", {}, t(name)), h("dd", {}, value)])),
    clip.warnings.length ? h("details", {}, h("summary", {}, t("doubts", { count: clip.warnings.length })), h("ul", { class: "plain-list" }, ...clip.warnings.map((text) => h("li", {}, text)))) : null,
    h("details", {}, h("summary", {}, t("where_file")), h("p", { class: "note" }, clip.path)),
    h("div", { class: "row detail-acts" }, ...placesFor([clip]).map(link), file, button("relabel", "tag"), button("remove", "trash", "danger")),
  ].filter(Boolean);
}

const round = (value) => String(Math.round(100 * value) / 100);
