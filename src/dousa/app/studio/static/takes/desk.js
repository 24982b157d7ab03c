// What is under the cursor, and where a part gets its name.

import { formatSeconds, h, icon, t } from "../core/dom.js";
import { kindOf, makeSwatch, nameOf, sayName } from "../core/timeline_parts.js";

// Going through the stretches of a take: the least sure first; right, split here, join with the next. Buttons and keys.
const KEYS = { u: "next_unsure", y: "right", x: "split", j: "join" };

const middle = (one) => 0.5 * (one.start_s + one.end_s);

const isOpen = (one) => !one.corrected && one.confidence != null;

export class Review {
  /** tools: {segments() -> stretches, time() -> s, onGo(segment), onLearn({start, end, category, split, replaces})
   *  -> whether it was learned, onChoose({start_s, end_s, category}), isShown()} */
  constructor(tools) {
    Object.assign(this, { tools, seen: [], busy: false });
    const button = (name, act) => h("button", { type: "button", class: "small", id: `review-${name}`, title: t(`${name}_title`), "aria-keyshortcuts": Object.keys(KEYS).find((key) => KEYS[key] === name), onclick: act }, t(name));
    this.acts = { next_unsure: () => this.goNext(), right: () => this.confirm(), split: () => this.split(), join: () => this.join() };
    this.buttons = Object.fromEntries(Object.entries(this.acts).map(([name, act]) => [name, button(name, act)]));
    this.element = h("div", { class: "row review", role: "group", "aria-label": t("review") }, ...Object.values(this.buttons));
    document.addEventListener("keydown", (event) => this.press(event));
  }

  now() {
    const [segments, time] = [this.tools.segments(), this.tools.time()];
    const place = segments.findIndex((one) => one.start_s <= time && time < one.end_s);
    return { one: segments[place] ?? null, next: place < 0 ? null : (segments[place + 1] ?? null) };
  }

  settle() {
    const { one, next } = this.now();
    const able = {
      next_unsure: this.tools.segments().some(isOpen),
      right: one && isOpen(one) && nameOf(one),
      split: one,
      join: one && next && (one.category || next.category),
    };
    for (const [name, button] of Object.entries(this.buttons)) button.disabled = this.busy || !able[name];
  }

  /** To the least sure stretch that was not looked at yet; after the last one it begins again. */
  goNext() {
    const open = this.tools.segments().filter(isOpen).sort((a, b) => a.confidence - b.confidence);
    const isSeen = (one) => this.seen.some((time) => one.start_s <= time && time < one.end_s);
    let found = open.find((one) => !isSeen(one));
    if (!found) {
      this.seen = [];
      found = open[0];
    }
    if (!found) return;
    this.seen.push(middle(found));
    this.tools.onGo(found);
  }

  async confirm() {
    const { one } = this.now();
    if (await this.learn({ start: one.start_s, end: one.end_s, category: nameOf(one) })) this.goNext();
  }

  /** Two stretches of one; of something unknown what begins here is chosen, to be named. */
  async split() {
    const [{ one }, at] = [this.now(), this.tools.time()];
    if (!one.category) {
      this.tools.onChoose({ ...one, start_s: at });
      return;
    }
    const replaces = one.corrected ? [one.corrected] : [];
    if (await this.learn({ start: one.start_s, end: one.end_s, split: at, category: one.category, replaces })) this.tools.onChoose({ ...one, start_s: at });
  }

  async join() {
    const { one, next } = this.now();
    const replaces = [...new Set([one, next].filter((part) => part.corrected).map((part) => part.corrected))];
    await this.learn({ start: one.start_s, end: next.end_s, category: one.category ?? next.category, replaces });
  }

  async learn(part) {
    this.busy = true;
    this.settle();
    const learned = await this.tools.onLearn(part);
    this.busy = false;
    this.settle();
    return learned;
  }

  press(event) {
    const name = KEYS[event.key];
    if (!name || event.ctrlKey || event.metaKey || event.altKey || !this.tools.isShown()) return;
    if (event.target.closest?.("input, textarea, select, dialog, [contenteditable]")) return;
    if (this.buttons[name].disabled) return;
    event.preventDefault();
    this.acts[name]();
  }
}

// The stretches of a take as a table.
function sayWhat(one) {
  const [kind, said] = [kindOf(one), sayName(kindOf(one), nameOf(one))];
  return kind === "unknown" || kind === "perhaps" ? h("i", {}, said) : said;
}

function confidence(one) {
  if (one.corrected) return h("span", {}, "✎ ", t("by_hand"));
  if (one.confidence == null) return t("given");
  const percent = Math.round(100 * one.confidence);
  return h("span", { class: "sure" }, h("span", { class: "track", "aria-hidden": "true" }, h("i", { style: { width: `${percent}%` } })), `${percent} %`);
}

export function often(one) {
  return nameOf(one) && one.repetitions > 1 ? h("span", { class: "often" }, `× ${one.repetitions}`) : "";
}

/** tools: {motion, tones, onGo(segment), onChoose(segment), onExport(segment)} */
export function drawSegments(element, segments, { motion, tones, onGo, onChoose, onExport }) {
  const scrolled = element.querySelector(".scroll")?.scrollTop ?? 0;
  const row = (one) => {
    const asked = new URLSearchParams({ motion, start_s: one.start_s.toFixed(2), end_s: one.end_s.toFixed(2) });
    return h(
      "tr",
      { dataset: { start: String(one.start_s) } },
      h("td", {}, h("button", { type: "button", class: "small quiet go", onclick: () => onGo(one), ondblclick: () => onChoose(one) }, `${formatSeconds(one.start_s)} – ${formatSeconds(one.end_s)}`)),
      h("th", { scope: "row" }, h("span", { class: "what" }, makeSwatch(kindOf(one), nameOf(one), tones, { "aria-hidden": "true" }), sayWhat(one), often(one))),
      h("td", {}, confidence(one)),
      h("td", { class: "acts" }, h("button", { type: "button", class: "small quiet", onclick: () => onChoose(one), title: t("correct_title") }, icon("tag"), h("span", { class: "word" }, t("correct_title"))), h("a", { class: "button small quiet", href: `/search?${asked}`, title: t("search_segment") }, icon("search"), h("span", { class: "word" }, t("search_word"))), h("button", { type: "button", class: "small quiet export", onclick: () => onExport(one), title: t("export_part") }, icon("download"), h("span", { class: "word" }, t("export_word")))),
    );
  };
  const head = ["time", "what", "sure", "act"].map((name) => h("th", { scope: "col" }, name === "act" ? h("span", { class: "sr" }, t("column_act")) : t(`column_${name}`)));
  const table = h("table", {}, h("thead", {}, h("tr", {}, ...head)), h("tbody", {}, ...segments.map(row)));
  element.replaceChildren(h("h2", {}, t("segments")), segments.length ? h("div", { class: "scroll" }, table) : h("p", { class: "note" }, t("not_labelled")));
  if (segments.length) element.querySelector(".scroll").scrollTop = scrolled;
}

export function markSegments(element, places) {
  const rows = element.querySelectorAll("tbody tr");
  const now = places.map((place) => rows[place]).filter(Boolean);
  const before = [...element.querySelectorAll("tr[aria-current]")];
  if (before.length === now.length && now.every((row, number) => row === before[number])) return;
  for (const row of before) row.removeAttribute("aria-current");
  for (const row of now) row.setAttribute("aria-current", "true");
  if (!now.length) return;
  const [box, inside] = [element.querySelector(".scroll"), now[0].offsetTop];
  if (inside < box.scrollTop + 30 || inside > box.scrollTop + box.clientHeight - 40) box.scrollTop = inside - box.clientHeight / 3;
}

export class Desk {
  /** tools: {onCorrect(part, category) -> whether it was learned, onUndo(id), onStretch(segment), onExport(part)};
   *  review: an element to go through the stretches with */
  constructor(element, tools, review) {
    Object.assign(this, { tools, part: null, now: null });
    this.what = h("p", { class: "now-what" });
    this.sure = h("p", { class: "note" });
    this.stretch = h("button", { type: "button", class: "small", id: "choose-stretch", onclick: () => this.now?.length && tools.onStretch(this.now[0]) });
    this.choices = h("div", { class: "choices" }, this.stretch); // more of them where several lie at one time
    this.options = h("datalist", { id: "categories" });
    this.input = h("input", { type: "text", id: "category", list: "categories", autocomplete: "off", maxlength: "200", placeholder: t("correct_placeholder"), oninput: () => this.settle() });
    this.button = h("button", { type: "submit", class: "primary", id: "correct" }, t("correct_button"));
    this.take = h("button", { type: "button", id: "export-part", onclick: () => this.part && tools.onExport(this.part) }, icon("download"), t("export_part"));
    this.span = h("p", { class: "part" });
    this.form = h("form", { class: "correct", onsubmit: (event) => this.submit(event) }, this.span, h("div", { class: "row" }, h("label", { class: "field" }, t("correct_category"), this.input), this.options, this.button, this.take));
    this.list = h("ul", { class: "corrections" });
    element.replaceChildren(h("div", { class: "now-head" }, h("div", {}, h("h2", { class: "sr" }, t("now")), this.what, this.sure), this.choices), review, h("h2", {}, t("correct_title")), this.form, this.list);
    this.setNow([]);
    this.setPart(null);
  }

  /** Of several stretches at one time each is said, and can be chosen. */
  setNow(segments, tones) {
    if (this.now && segments.length === this.now.length && segments.every((one, number) => one === this.now[number])) return;
    this.now = segments;
    const several = segments.length > 1;
    const word = (one) => (several ? t("correct_named", { category: sayName(kindOf(one), nameOf(one)) }) : t("correct_stretch"));
    const choose = (one) => h("button", { type: "button", class: "small", onclick: () => this.tools.onStretch(one) }, word(one));
    this.stretch.disabled = !segments.length;
    this.stretch.textContent = word(segments[0]);
    for (const button of [...this.choices.children].slice(1)) button.remove(); // the first one keeps the focus
    this.choices.append(...segments.slice(1).map(choose));
    if (!segments.length) {
      this.what.replaceChildren("–");
      this.sure.textContent = "";
      return;
    }
    const say = (one) => h("span", { class: "now-one" }, makeSwatch(kindOf(one), nameOf(one), tones), sayName(kindOf(one), nameOf(one)), often(one));
    this.what.replaceChildren(...segments.map(say));
    this.sure.textContent = [...new Set(segments.map((one) => this.saySure(one)))].join(", ");
  }

  saySure(one) {
    if (one.corrected) return t("timeline_corrected");
    if (one.confidence == null) return t("given");
    return t({ unknown: "sure_unknown", perhaps: "sure_perhaps" }[kindOf(one)] ?? "sure", { percent: Math.round(100 * one.confidence) });
  }

  /** category: what the part is called already; what was typed stays if left out */
  setPart(part, category) {
    this.part = part;
    if (category !== undefined) this.input.value = category ?? "";
    this.span.textContent = part ? t("timeline_part", { start: formatSeconds(part.start), end: formatSeconds(part.end) }) : t("correct_hint");
    this.span.classList.toggle("chosen", Boolean(part));
    this.settle();
  }

  setCategories(names) {
    this.options.replaceChildren(...names.sort().map((name) => h("option", { value: name })));
  }

  setCorrections(corrections) {
    const row = (one) =>
      h("li", {}, h("span", {}, "✎ ", h("b", {}, one.category)), h("span", { class: "note" }, `${formatSeconds(one.start_s)} – ${formatSeconds(one.end_s)}`), h("button", { type: "button", class: "small undo", onclick: () => this.tools.onUndo(one.id), "aria-label": `${t("undo")}: ${one.category}, ${formatSeconds(one.start_s)}` }, t("undo")));
    this.list.replaceChildren(...corrections.map(row));
  }

  settle() {
    this.take.disabled = !this.part;
    this.button.disabled = this.busy || !this.part || !this.input.value.trim();
  }

  async submit(event) {
    event.preventDefault();
    if (this.button.disabled) return;
    this.busy = true;
    this.button.textContent = t("learning");
    this.settle();
    const learned = await this.tools.onCorrect(this.part, this.input.value.trim());
    this.busy = false;
    this.button.textContent = t("correct_button");
    if (learned) this.input.value = "";
    this.settle();
  }
}
