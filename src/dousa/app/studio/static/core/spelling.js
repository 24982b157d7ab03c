// What is asked on a page, as a command and as Python to copy: the studio makes both from the request.

import { openDialog } from "./dialog.js";
import { h, t } from "./dom.js";
import { attempt, notify } from "./notices.js";

/** A button that shows both; ask() -> {command, python, note} */
export const spellingButton = (ask, kind = "small") => h("button", { type: "button", class: `${kind} spelling`, onclick: () => attempt(async () => show(await ask())) }, t("spelling"));

function show({ command, python, note }) {
  const copy = async (text) => {
    await navigator.clipboard.writeText(text);
    notify(t("spelling_copied"));
  };
  const part = (name, text) => h("section", {}, h("div", { class: "row" }, h("h3", {}, t(name)), h("button", { type: "button", class: "small push", dataset: { copy: name }, onclick: () => attempt(() => copy(text)) }, t("share_copy"))), h("pre", { class: "scroll", tabindex: "0" }, text));
  const parts = [command ? part("spelling_command", command) : h("p", { class: "note" }, note), part("spelling_python", python)];
  openDialog(t("spelling_title"), h("div", { class: "stack" }, ...parts), { wide: true });
}
