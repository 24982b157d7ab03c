// The clips of the library, some at a time; a press on one plays it.

import { get, getBytes } from "../core/api.js";
import { $, formatSeconds, h, language, later, t } from "../core/dom.js";
import { openDialog } from "../core/dialog.js";
import { attempt } from "../core/notices.js";

const AT_ONCE = 24;
const calm = window.matchMedia("(prefers-reduced-motion: reduce)");
let [text, shown, turn] = ["", 0, 0];
let figures = [];

async function drawFigure(canvas, motion) {
  try {
    const bytes = await getBytes("/motions/miniature", { motion });
    if (canvas.isConnected) figures.push(window.dousa.createMiniature(canvas, bytes));
  } catch {
    // its name is there all the same
  }
}

function clipRow({ id, name, category, duration }) {
  const canvas = h("canvas", { class: "figure-small", "aria-hidden": "true" });
  const motion = `clip:${id}`;
  const about = h("span", { class: "note" }, [category || t("no_label"), formatSeconds(duration)].join(" · "));
  const row = h("li", {}, h("button", { type: "button", class: "shared-clip", onclick: () => attempt(() => play(motion, name)) }, canvas, h("span", { class: "shared-text" }, h("b", {}, name), about)));
  drawFigure(canvas, motion);
  return row;
}

async function play(motion, name) {
  const data = await get("/motions/player", { motion, language });
  const place = h("div", {});
  let player = null;
  openDialog(name, place, { wide: true, onClose: () => player?.destroy() });
  player = window.dousa.createPlayer(place, data);
  player.loop(0, player.duration);
  if (!calm.matches) player.play();
}

async function addMore(fresh) {
  const mine = fresh ? ++turn : turn;
  const offset = fresh ? 0 : shown;
  const { total, items } = await get("/clips", { text, offset, limit: AT_ONCE });
  if (mine !== turn) return;
  if (fresh) {
    figures.forEach((one) => one.destroy());
    figures = [];
    $("#shared-clips").replaceChildren();
  }
  shown = offset + items.length;
  $("#shared-clips").append(...items.map(clipRow));
  $("#shared-count").textContent = t("clip_count", { count: total });
  $("#shared-more").hidden = shown >= total;
}

export function showLibrary() {
  $("#shared-library").hidden = false;
  $("#shared-more").addEventListener("click", () => attempt(() => addMore(false)));
  $("#shared-text").addEventListener("input", later(() => {
    text = $("#shared-text").value;
    attempt(() => addMore(true));
  }, 200));
  attempt(() => addMore(true));
}
