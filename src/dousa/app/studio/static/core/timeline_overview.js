// The whole of a timeline in little, while only a part of it is seen; click or drag to see another part.

import { h } from "./dom.js";
import { drawStrip, place } from "./timeline_parts.js";

export class Overview {
  /** scroll: the element that scrolls; onGo(share): the middle of what is to be seen. */
  constructor(scroll, onGo) {
    this.scroll = scroll;
    this.strip = h("div", { class: "tl-strip" });
    this.frame = h("div", { class: "tl-frame" });
    this.element = h("div", { class: "tl-overview", hidden: true, "aria-hidden": "true" }, this.strip, this.frame);
    const go = (event) => {
      const box = this.element.getBoundingClientRect();
      onGo((event.clientX - box.left) / box.width);
    };
    this.element.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      this.element.setPointerCapture(event.pointerId);
      go(event);
    });
    this.element.addEventListener("pointermove", (event) => event.buttons && go(event));
    scroll.addEventListener("scroll", () => this.place(), { passive: true });
  }

  draw(segments, duration, tones) {
    drawStrip(this.strip, segments, duration, tones);
  }

  place() {
    const { scrollLeft, clientWidth, scrollWidth } = this.scroll;
    this.element.hidden = scrollWidth <= clientWidth + 2;
    Object.assign(this.frame.style, place(scrollLeft, scrollLeft + clientWidth, scrollWidth));
  }
}
