// A dialog to choose motions of the library.

import { get } from "./api.js";
import { baseName, formatSeconds, h, later, t } from "./dom.js";
import { attempt } from "./notices.js";

/** options: {kind: "clip" | "take" | undefined, multiple: bool, title} -> clips chosen (may be empty), as GET /api/clips gives them */
export function pickClips({ kind, multiple = false, title = t("pick_title") } = {}) {
  const chosen = new Map();
  const list = h("div", { class: "pick-list", role: "listbox", "aria-multiselectable": String(multiple) });
  const search = h("input", { type: "search", placeholder: t("pick_search"), "aria-label": t("pick_search") });
  const use = h("button", { type: "submit", class: "primary", disabled: true }, t("pick_use"));
  const dialog = h(
    "dialog",
    { class: "picker", "aria-label": title },
    h("form", { method: "dialog" }, h("h2", {}, title), search, list, h("div", { class: "foot" }, h("button", { type: "button", onclick: () => dialog.close("cancel") }, t("cancel")), use)),
  );
  const row = (clip) => {
    const item = h(
      "button",
      { type: "button", class: "pick", role: "option", "aria-selected": String(chosen.has(clip.id)), dataset: { clip: clip.id } },
      h("span", { class: "badge" }, clip.category ?? t(clip.kind === "take" ? "take" : "no_label")),
      h("span", { class: "name" }, baseName(clip.path)),
      h("span", { class: "note" }, formatSeconds(clip.duration)),
    );
    item.addEventListener("click", () => {
      if (!multiple) {
        chosen.clear();
        chosen.set(clip.id, clip);
        dialog.close("use");
        return;
      }
      if (chosen.has(clip.id)) chosen.delete(clip.id);
      else chosen.set(clip.id, clip);
      item.setAttribute("aria-selected", String(chosen.has(clip.id)));
      use.disabled = chosen.size === 0;
    });
    return item;
  };
  const fill = () =>
    attempt(async () => {
      const { items } = await get("/clips", { text: search.value, kind, limit: 60 });
      list.replaceChildren(...(items.length ? items.map(row) : [h("p", { class: "note" }, t("pick_none"))]));
    });
  search.addEventListener("input", later(fill, 150));
  search.addEventListener("keydown", (event) => event.key === "Enter" && event.preventDefault());
  document.body.append(dialog);
  dialog.showModal();
  fill();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => {
      const used = dialog.returnValue !== "cancel" && chosen.size > 0;
      dialog.remove();
      resolve(used ? [...chosen.values()] : []);
    });
  });
}
