// What of a report lies open: advice, player and worst moments for everybody, what they rest on for who opens it.

import { $, h } from "../core/dom.js";

const FOLD = "dousa_analysis"; // whether somebody opened it last time

export function foldAnalysis(root) {
  const head = $("#analysis", root);
  const rest = [];
  for (let next = head.nextElementSibling; next; next = next.nextElementSibling) rest.push(next);
  const title = $("h2", head);
  const fold = h("details", { class: "analysis", id: "analysis", open: localStorage.getItem(FOLD) === "open" }, h("summary", {}, title), ...[...head.children].filter((one) => one !== title), ...rest);
  fold.addEventListener("toggle", () => localStorage.setItem(FOLD, fold.open ? "open" : "closed"));
  head.replaceWith(fold);
}

// On a phone the pictures of all figures would be a long way to scroll: the first one stays open.
export function foldForPhones(root) {
  if (window.innerWidth >= 700) return;
  for (const card of [...root.querySelectorAll(".shape-card[open]")].slice(1)) card.open = false;
}
