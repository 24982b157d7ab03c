// Reasons in words. They come in English with all their numbers; in Japanese the sentence is made here.

import { formatSeconds, h, language, t } from "../core/dom.js";

const WORDS = [
  ["left shoulder", "左肩"], ["right shoulder", "右肩"], ["left elbow", "左肘"], ["right elbow", "右肘"], ["left wrist", "左手首"], ["right wrist", "右手首"],
  ["left hand", "左手"], ["right hand", "右手"], ["left hip", "左股関節"], ["right hip", "右股関節"], ["left knee", "左膝"], ["right knee", "右膝"],
  ["left foot", "左足"], ["right foot", "右足"], ["left toe", "左つま先"], ["right toe", "右つま先"], ["left leg", "左脚"], ["right leg", "右脚"], ["left arm", "左腕"],
  ["right arm", "右腕"], ["head", "頭"], ["neck", "首"], ["spine", "背骨"], ["pelvis", "骨盤"], ["trunk", "胴"], ["body", "体"], ["speed", "速さ"], ["height", "高さ"],
  ["seen from the front", "（正面から）"], ["seen from the side", "（横から）"], ["seen from above", "（上から）"], [" to the left of the ", "の左右位置："], [" in front of the ", "の前後位置："],
  [" above the ", "の上下位置："], ["to the left", "左向き"], ["upwards", "上向き"], ["forwards", "前向き"], ["distance ", "距離："], [" and ", "と"], [" of ", "："], ["the ", ""], [" - ", "と"],
];
const UNITS = { "body heights": "身長比", "body heights a second": "身長比/秒", "radians a second": "rad/秒", radians: "rad", degrees: "度" };
const KINDS = { mean: "平均", spread: "ばらつき", trend: "変化" };

function translate(name) {
  let text = name;
  for (const [english, japanese] of WORDS) text = text.replaceAll(english, japanese);
  return text;
}

const span = (start, end) => `${start.toFixed(1)}〜${end.toFixed(1)} 秒`;

function sayJapanese(reason) {
  const there = reason.other_start === undefined ? "" : `（相手は ${span(reason.other_start, reason.other_end)}）`;
  const values = [reason.value, reason.other_value].filter((value) => value !== undefined).map((value) => value.toFixed(2));
  const unit = UNITS[reason.unit] ?? reason.unit;
  const others = `多くの動きは ${reason.threshold.toFixed(2)} ${reason.above ? "未満" : "超"}`;
  return `${translate(reason.channel)}：${span(reason.start, reason.end)}${there}の${KINDS[reason.kind] ?? reason.kind}が ${values.join(" と ")}（${unit}）。${others}`;
}

/** A list of reasons; a click on one goes to its moment: onGo(start, end). */
export function listReasons(reasons, onGo) {
  if (!reasons?.length) return h("p", { class: "note" }, t("why_nothing"));
  const item = (reason) =>
    h(
      "li",
      {},
      h("span", {}, language === "ja" ? sayJapanese(reason) : reason.text),
      h("button", { type: "button", class: "small quiet", onclick: () => onGo(reason.start, reason.end), "aria-label": `${t("play")} ${formatSeconds(reason.start)}` }, "▶ ", formatSeconds(reason.start)),
    );
  return h("ol", { class: "reasons" }, ...reasons.map(item));
}
