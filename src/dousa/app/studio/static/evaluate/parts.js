// Parts of the report are replaced in place: what is open stays open, what is scrolled stays, the focus stays.

import { $ } from "../core/dom.js";

const FOLD = "dousa_analysis"; // whether somebody opened it last time

/** Let the analysis lie open where it did last time. */
export function foldAnalysis(root) {
  const fold = $("#analysis", root);
  fold.open = localStorage.getItem(FOLD) === "open";
  fold.addEventListener("toggle", () => localStorage.setItem(FOLD, fold.open ? "open" : "closed"));
}

const shown = new WeakMap(); // element -> markup
const KEEPS = ".scroll, .table-wrap";

const pathOf = (element) => ["event", "lapse"].filter((name) => element.dataset?.[name] !== undefined).map((name) => `[data-${name}="${element.dataset[name]}"]`)[0] ?? (element.id ? `#${CSS.escape(element.id)}` : null);

function remember(element) {
  const active = element.contains(document.activeElement) ? document.activeElement : null;
  const open = [...element.querySelectorAll("details")].map((one) => one.open);
  const places = [element, ...element.querySelectorAll(KEEPS)].map((one) => [one.scrollLeft, one.scrollTop]);
  return { focus: active && pathOf(active), open, places };
}

function restore(element, { focus, open, places }) {
  const details = [...element.querySelectorAll("details")];
  // Where there are others now they say themselves what is open.
  if (details.length === open.length) details.forEach((one, place) => { one.open = open[place]; });
  [element, ...element.querySelectorAll(KEEPS)].forEach((one, place) => {
    if (places[place]) [one.scrollLeft, one.scrollTop] = places[place];
  });
  if (focus) element.querySelector(focus)?.focus({ preventScroll: true });
}

/** Put the parts {name: markup}, as the studio made them, into the elements of the frame. */
export function putParts(root, parts) {
  for (const [name, markup] of Object.entries(parts)) {
    const element = root.querySelector(`[data-part="${name}"]`);
    if (!element || shown.get(element) === markup) continue;
    const before = shown.has(element) ? remember(element) : null;
    shown.set(element, markup);
    element.innerHTML = markup;
    if (before) restore(element, before);
  }
}
