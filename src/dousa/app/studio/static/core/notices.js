// Short messages in a corner of the page, read out by screen readers.

import { $, $$, h, icon, t } from "./dom.js";

const SHOWN_FOR = 6000; // ms; problems stay until they are closed
const WITH_ACTION = 15000; // ms to make up one's mind

const CORNERS = ["bottom right", "bottom left", "top right", "top left"];
const USED = "button, a[href], input, select, textarea, summary, [role=slider], [role=gridcell]";

/** Into the corner where the messages lie over the fewest things that can be used; they stay where they are if that is no worse. */
function settle() {
  const place = $("#notices");
  const boxes = $$(USED).filter((one) => !place.contains(one) && one.checkVisibility()).map((one) => one.getBoundingClientRect());
  const count = (corner) => {
    place.dataset.corner = corner;
    const own = place.getBoundingClientRect();
    return boxes.filter((box) => box.left < own.right && box.right > own.left && box.top < own.bottom && box.bottom > own.top).length;
  };
  const corners = [place.dataset.corner ?? CORNERS[0], ...CORNERS];
  const counts = corners.map(count);
  place.dataset.corner = corners[counts.indexOf(Math.min(...counts))];
}

/** kind: "note" or "problem"; action: a button beside the text. */
export function notify(text, kind = "note", action = null) {
  if (kind === "problem") withdraw(text); // two requests that fail for one reason say it once
  const close = () => notice.remove();
  const notice = h(
    "div",
    { class: `notice ${kind}`, role: kind === "problem" ? "alert" : null },
    h("span", { class: "mark" }, kind === "problem" ? t("problem") : t("done")),
    h("p", {}, text),
    action,
    h("button", { class: "quiet small icon", type: "button", "aria-label": t("close"), onclick: close }, icon("close")),
  );
  $("#notices").append(notice);
  while ($("#notices").children.length > 4) $("#notices").firstChild.remove();
  settle();
  if (kind !== "problem") setTimeout(close, action ? WITH_ACTION : SHOWN_FOR);
}

export function withdraw(text) {
  for (const notice of $$(".problem", $("#notices"))) if ($("p", notice).textContent === text) notice.remove();
}

/** Show why the page cannot do what was asked, in its head; "" for no problem. */
export function showProblem(text) {
  $("#problem").textContent = text;
  $("#problem").hidden = !text;
}

/** Run something asynchronous; what goes wrong is told, not thrown. -> its value, or undefined. */
export async function attempt(action) {
  try {
    return await action();
  } catch (error) {
    if (error.name !== "AbortError") notify(error.message, "problem");
    return undefined;
  }
}
