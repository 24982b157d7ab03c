// Reasons in words: they come in English; in Japanese the sentence is made of their numbers.

import { formatSeconds, h, language, t } from "../core/dom.js";
import { sayJapanese } from "./reasons_ja.js";

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
