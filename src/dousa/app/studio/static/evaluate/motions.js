// A chosen motion as a row: a small moving figure, its name and length, a part of it, buttons.

import { get, getBytes } from "../core/api.js";
import { formatSeconds, h, icon, t } from "../core/dom.js";
import { notify } from "../core/notices.js";
import { plain } from "./state.js";

const known = new Map(); // motion -> promise of what it is

/** Name, length and more of a motion. */
export function describeMotion(ref) {
  const asked = plain({ ...ref, start_s: null, end_s: null });
  const key = JSON.stringify(asked);
  if (!known.has(key)) known.set(key, get("/motions/info", asked));
  return known.get(key);
}

async function drawFigure(canvas, ref) {
  try {
    window.dousa.createMiniature(canvas, await getBytes("/motions/miniature", plain(ref)), { host: canvas.parentElement });
  } catch {
    // the row says what is wrong
  }
}

function partFields(ref, duration, onChange) {
  const field = (name, word) => {
    const input = h("input", { type: "number", min: "0", max: duration.toFixed(2), step: "0.1", value: ref[name] ?? "", "aria-label": t(word), placeholder: t(word) });
    input.addEventListener("change", () => {
      const value = input.value === "" ? null : Number(input.value);
      onChange({ ...ref, [name]: Number.isFinite(value) ? value : null });
    });
    return input;
  };
  const open = ref.start_s != null || ref.end_s != null;
  return h("details", { class: "part", open }, h("summary", {}, t("part")), h("div", { class: "row" }, field("start_s", "part_from"), "–", field("end_s", "part_to")));
}

/** options: {first: bool, onChange(ref), onRemove(), onFirst()} -> row; onBroken() when the motion cannot be used */
export function motionRow(ref, { first = false, onChange, onRemove, onFirst = null, onBroken = () => {} }) {
  const canvas = h("canvas", { class: "figure-small", "aria-hidden": "true" });
  const name = h("b", { class: "motion-name" }, ref.motion.split("/").pop());
  const facts = h("span", { class: "note" }, t("loading"));
  const remove = h("button", { type: "button", class: "quiet small icon", onclick: onRemove }, icon("close"));
  const front = onFirst ? h("button", { type: "button", class: "quiet small", onclick: onFirst }, t("make_first")) : null;
  const text = h("div", { class: "motion-text" }, h("div", { class: "row" }, name, first ? h("span", { class: "badge" }, t("first")) : null), facts);
  const row = h("li", { class: "motion", dataset: { motion: ref.motion } }, canvas, text, front, remove);
  remove.setAttribute("aria-label", t("take_away", { name: name.textContent }));
  describeMotion(ref).then(
    (info) => {
      name.textContent = name.title = info.name || t("unnamed");
      remove.setAttribute("aria-label", t("take_away", { name: info.name }));
      facts.textContent = [info.category, formatSeconds(info.duration_s)].filter(Boolean).join(" · ");
      text.append(partFields(ref, info.duration_s, onChange));
      drawFigure(canvas, ref);
    },
    (error) => {
      facts.textContent = error.message;
      facts.classList.add("bad");
      notify(error.message, "problem");
      onBroken();
    },
  );
  return row;
}
