// One clip in the grid: its figure, its label, its name. Cells are used again for other clips as the page scrolls.

import { CutText } from "../core/cut.js";
import { formatSeconds, h, icon, t } from "../core/dom.js";
import { FAVOURITE } from "./tags.js";

const META_TAIL = 3; // characters of a performer that stay: the number

export class Cell {
  constructor() {
    this.canvas = h("canvas", { hidden: true });
    this.badgeInner = h("span", {});
    this.badgeText = new CutText(this.badgeInner);
    this.badge = h("span", { class: "badge" }, this.badgeInner);
    this.kind = h("span", { class: "kind" }, t("take"));
    this.name = h("span", { class: "name" });
    this.nameText = new CutText(this.name);
    this.meta = h("span", { class: "meta" });
    this.metaText = new CutText(this.meta, META_TAIL);
    this.length = h("span", { class: "length" });
    this.tick = h("span", { class: "tick", "aria-hidden": "true" }, icon("mark"));
    this.star = h("span", { class: "star", role: "img", "aria-label": t("favourite") }, icon("star"));
    this.lack = h("span", { class: "lack", hidden: true }, t("no_picture"));
    this.scrubber = h("i", { class: "scrub-mark", hidden: true });
    this.element = h(
      "div",
      { class: "cell", role: "gridcell", tabindex: "-1" },
      h("span", { class: "stage" }, this.canvas, this.lack, this.kind, this.star, this.length, this.tick, this.scrubber),
      h("span", { class: "text" }, this.name, h("span", { class: "below" }, this.badge, this.meta)),
    );
    this.stage = this.element.firstChild;
    this.stage.addEventListener("pointermove", (event) => this.scrub(event));
    this.stage.addEventListener("pointerleave", () => {
      this.pointer = null;
      this.runOn();
    });
    this.shown = "";
    this.pointer = null;
    this.bytes = undefined;
  }

  /** Show a clip (undefined: not here yet), or nothing (index null: behind the end of the list). */
  show(index, clip, bytes) {
    this.index = index;
    this.id = clip?.id ?? null;
    const key = clip ? `${clip.id} ${clip.category} ${clip.performer} ${clip.predicted_category} ${clip.tags}` : `${index === null}`;
    if (key !== this.shown) this.write(index, clip);
    this.shown = key;
    if (bytes !== this.bytes) this.draw(bytes);
  }

  write(index, clip) {
    const { element } = this;
    element.classList.toggle("waiting", !clip);
    element.style.visibility = index === null ? "hidden" : "";
    element.title = clip ? [clip.folder, clip.name].filter(Boolean).join("/") : "";
    this.nameText.set(clip?.name ?? "");
    this.kind.hidden = clip?.kind !== "take";
    this.star.hidden = !clip?.tags.includes(FAVOURITE);
    const guessed = clip && !clip.category && clip.kind !== "take" && clip.predicted_category;
    this.badge.className = `badge${guessed ? " unsure" : ""}${clip && !clip.category && !guessed ? " none" : ""}`;
    this.badgeText.set(clip ? label(clip, guessed) : "");
    this.badge.hidden = !clip || (clip.kind === "take" && !clip.category);
    this.metaText.set([clip?.performer, ...(clip?.tags ?? []).filter((tag) => tag !== FAVOURITE).map((tag) => `#${tag}`)].filter(Boolean).join(" "));
    this.length.textContent = clip ? formatSeconds(clip.duration) : "";
  }

  draw(bytes) {
    this.bytes = bytes;
    this.runOn();
    this.canvas.hidden = !bytes;
    this.lack.hidden = bytes !== null;
    if (!bytes) return;
    if (this.miniature) this.miniature.replace(bytes);
    else this.miniature = window.dousa.createMiniature(this.canvas, bytes, { host: this.element });
    if (this.pointer && this.stage.matches(":hover")) this.scrub(this.pointer); // was there before the figure
  }

  /** The pointer's place over the figure is a moment of the motion; not where less motion is wished for. */
  scrub(event) {
    this.pointer = event;
    const { clientX, pointerType, buttons } = event;
    if (pointerType !== "mouse" || buttons || !this.miniature || this.miniature.calm || this.canvas.hidden) return;
    const { left, width } = this.stage.getBoundingClientRect();
    const share = Math.min(Math.max((clientX - left) / width, 0), 1);
    this.miniature.scrub(share);
    this.scrubber.hidden = false;
    this.scrubber.style.left = `${100 * share}%`;
  }

  runOn() {
    if (this.scrubber.hidden) return;
    this.scrubber.hidden = true;
    this.miniature?.scrub(null);
  }

  mark(selected, active) {
    // Even an attribute that stays the same costs a look at the styles.
    if (this.element.getAttribute("aria-selected") !== String(selected)) this.element.setAttribute("aria-selected", String(selected));
    if (this.element.tabIndex !== (active ? 0 : -1)) this.element.tabIndex = active ? 0 : -1;
  }

  destroy() {
    this.miniature?.destroy();
  }
}

const label = (clip, guessed) => clip.category ?? (guessed ? t("guess", { name: guessed }) : t("no_label"));
