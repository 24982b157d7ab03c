// What is under the cursor, and where a part gets its name.

import { formatSeconds, h, icon, t } from "../core/dom.js";
import { kindOf, makeSwatch, nameOf, sayName } from "../core/timeline_parts.js";
import { often } from "./segments.js";

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
