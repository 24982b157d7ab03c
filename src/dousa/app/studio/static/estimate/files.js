// The table of uploaded files and what each is used as.

import { baseName, h, t } from "../core/dom.js";

const ROLES = ["source", "cameras", "background", "body", "start", "unused"];

/** files: [{name, role, kind, n_files}]; on: {change(name, role), again()} */
export function showFiles(place, files, on) {
  const focused = place.contains(document.activeElement) ? document.activeElement.dataset.name : null;
  if (!files.length) {
    place.replaceChildren();
    return;
  }
  place.replaceChildren(
    h(
      "table",
      { class: "files" },
      h("thead", {}, h("tr", {}, h("th", { scope: "col" }, t("files_name")), h("th", { scope: "col" }, t("files_role")))),
      h("tbody", {}, ...files.map((file) => row(file, on.change))),
    ),
    h("div", { class: "files-foot" }, h("span"), h("button", { type: "button", class: "small quiet", onclick: on.again }, t("files_again"))),
  );
  if (focused) [...place.querySelectorAll("select")].find((select) => select.dataset.name === focused)?.focus();
}

function row(file, change) {
  const shown = file.name === "." ? "/" : baseName(file.name);
  const select = h(
    "select",
    { "aria-label": t("files_role_of", { name: shown }), dataset: { name: file.name }, onchange: () => change(file.name, select.value) },
    ...ROLES.map((role) => h("option", { value: role, selected: role === file.role }, t(`role_${role}`))),
  );
  const kind = t(`kind_${file.kind}`, { count: file.n_files });
  return h("tr", {}, h("th", { scope: "row" }, shown, kind ? h("span", { class: "note" }, kind) : null), h("td", {}, select));
}
