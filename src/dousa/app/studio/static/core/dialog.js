// The frame of all dialogs.

import { count, h, icon, t } from "./dom.js";

/** A dialog with a heading; it is gone when it is closed. -> {dialog, close} */
export function openDialog(title, content, { wide = false, onClose = () => {} } = {}) {
  const close = () => dialog.close();
  const dialog = h(
    "dialog",
    { class: wide ? "wide" : "", "aria-label": title },
    h("div", { class: "inside" }, h("header", { class: "dialog-head" }, h("h2", {}, title), h("button", { type: "button", class: "quiet icon", "aria-label": t("close"), onclick: close }, icon("close"))), content),
  );
  const before = document.activeElement;
  dialog.addEventListener("close", () => {
    dialog.remove();
    if (before?.isConnected) before.focus({ preventScroll: true });
    onClose();
  });
  dialog.addEventListener("pointerdown", (event) => event.target === dialog && outside(dialog, event) && close());
  document.body.append(dialog);
  dialog.showModal();
  return { dialog, close };
}

function outside(dialog, { clientX: x, clientY: y }) {
  const box = dialog.getBoundingClientRect();
  return x < box.left || x > box.right || y < box.top || y > box.bottom;
}

/** Row of buttons at the foot of a dialog; pressing Enter in a field presses the last. */
export const foot = (...buttons) => h("div", { class: "foot" }, ...buttons);

/** A table that is folded: names, and what is said of each; null if there are none. */
export function pairTable(title, rows, { kind = "", open = false } = {}) {
  if (!rows.length) return null;
  const lines = rows.map(([name, text]) => h("tr", {}, h("th", { scope: "row" }, name), h("td", {}, text)));
  return h("details", { class: kind, open }, h("summary", {}, t(title, { count: count.format(rows.length) })), h("div", { class: "scroll" }, h("table", {}, h("tbody", {}, ...lines))));
}
