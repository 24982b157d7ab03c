// Reasons in words.

import { formatSeconds, h, t } from "../core/dom.js";

/** A list of reasons; a click on one goes to its moment: onGo(start, end). */
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
