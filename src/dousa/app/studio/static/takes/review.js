// Going through the stretches of a take: the least sure first; right, split here, join with the next. Buttons and keys.

import { h, t } from "../core/dom.js";
import { nameOf } from "../core/timeline_parts.js";

const KEYS = { u: "next_unsure", y: "right", x: "split", j: "join" };

const middle = (one) => 0.5 * (one.start_s + one.end_s);

/** Only what was recognised is open to doubt: not what people said. */
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

  /** The stretch under the cursor, and the one after it. */
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
