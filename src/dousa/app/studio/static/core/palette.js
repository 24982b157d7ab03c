// Ctrl+K: everything that can be done from here, by typing a part of its name; ? lists the keys.

import { get } from "./api.js";
import { openDialog } from "./dialog.js";
import { $, $$, h, language, t } from "./dom.js";

const MOST_SHOWN = 40;
const MOST_JOBS = 20;
const folded = (text) => text.normalize("NFKC").toLowerCase();
let opened = false;

/** What can be chosen: {kind, text, act}. jobPlace(job) -> address of its page, or null */
async function listAll(jobPlace) {
  const go = (href) => () => location.assign(href);
  const pages = $$(".bar nav a, .foot-line a").map((link) => ({ kind: "palette_page", text: link.textContent.trim(), act: go(link.href) }));
  const here = $$("main button, main summary, .actions-bar button, .actions-bar a, .bar-end button")
    .filter((one) => one.checkVisibility() && !one.disabled && !one.closest("[role=row], .names, .dousa-player, dialog"))
    .map((one) => ({ kind: "palette_act", text: (one.textContent.trim() || one.getAttribute("aria-label") || "").replace(/\s+/g, " "), act: () => (one.focus(), one.click()) }))
    .filter(({ text }) => text.length > 1);
  const jobs = await get("/jobs", { limit: MOST_JOBS }).then((answer) => answer.jobs, () => []);
  const places = jobs.map((job) => [job, jobPlace(job)]).filter(([, href]) => href);
  return [...pages, ...here, ...places.map(([job, href]) => ({ kind: "palette_job", text: `${t("job_title", { kind: t(`kind_${job.kind}`), title: job.title })} (${t(`state_${job.state}`)})`, act: go(href) }))];
}

/** The higher the better: begins so, has all words, has the letters in this order; 0: does not fit. */
function fit(text, asked) {
  const [own, words] = [folded(text), folded(asked).split(/\s+/).filter(Boolean)];
  if (!words.length) return 1;
  if (own.startsWith(folded(asked).trim())) return 4;
  if (words.every((word) => own.includes(word))) return 3;
  let at = 0;
  for (const letter of words.join("")) {
    at = own.indexOf(letter, at) + 1;
    if (!at) return 0;
  }
  return 1;
}

async function openPalette(jobPlace) {
  if (opened || $("dialog[open]")) return;
  opened = true;
  const all = await listAll(jobPlace);
  const field = h("input", { type: "search", id: "palette-field", role: "combobox", "aria-expanded": "true", "aria-controls": "palette-list", "aria-label": t("palette"), placeholder: t("palette_hint"), autocomplete: "off", spellcheck: "false", maxlength: "200" });
  const list = h("ul", { id: "palette-list", class: "palette-list", role: "listbox", "aria-label": t("palette") });
  let [shown, at] = [[], 0];
  const { close } = openDialog(t("palette"), h("div", { class: "stack palette" }, field, list), { onClose: () => (opened = false) });
  const run = (one) => {
    close();
    one?.act();
  };
  const mark = () => {
    [...list.children].forEach((row, place) => row.setAttribute("aria-selected", String(place === at)));
    field.setAttribute("aria-activedescendant", shown.length ? `palette-${at}` : "");
    list.children[at]?.scrollIntoView({ block: "nearest" });
  };
  const show = () => {
    const asked = field.value.trim();
    shown = all.map((one) => [fit(one.text, asked), one]).filter(([score]) => score > 0).sort((a, b) => b[0] - a[0]).map(([, one]) => one).slice(0, MOST_SHOWN);
    if (asked) shown.push({ kind: "palette_find", text: t("palette_in_library", { text: asked }), act: () => location.assign(`/library?text=${encodeURIComponent(asked)}`) });
    at = 0;
    list.replaceChildren(...shown.map((one, place) => h("li", { role: "option", id: `palette-${place}`, class: "palette-row", onclick: () => run(one) }, h("span", {}, one.text), h("span", { class: "note" }, t(one.kind)))));
    mark();
  };
  field.addEventListener("input", show);
  field.addEventListener("keydown", (event) => {
    const by = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (event.key === "Escape") {
      event.preventDefault(); // a field of this type would first be emptied
      close();
      return;
    }
    if (by) at = (at + by + shown.length) % Math.max(shown.length, 1);
    else if (event.key !== "Enter") return;
    event.preventDefault();
    if (by) mark();
    else run(shown[at]);
  });
  show();
  field.focus();
}

function openKeys() {
  if ($("dialog[open]")) return;
  const page = document.body.dataset.page;
  const rows = (name) => t(name) === name ? [] : t(name).split("|").map((line) => line.split("="));
  const list = [...rows("keys_everywhere"), ...rows(`keys_${page}`)];
  openDialog(t("keys"), h("dl", { class: "key-list", lang: language }, ...list.flatMap(([key, what]) => [h("dt", {}, h("kbd", {}, key)), h("dd", {}, what)])));
}

export function listenForPalette(jobPlace) {
  document.addEventListener("keydown", (event) => {
    if ((event.ctrlKey || event.metaKey) && !event.altKey && event.key.toLowerCase() === "k") {
      event.preventDefault();
      openPalette(jobPlace);
    } else if (event.key === "?" && !event.ctrlKey && !event.metaKey && !event.target.closest?.("input:not([type=checkbox]):not([type=range]), textarea, select")) {
      event.preventDefault();
      openKeys();
    }
  });
}
