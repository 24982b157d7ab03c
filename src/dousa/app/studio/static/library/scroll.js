// What the list of clips scrolls in: a pane of its own where the window is large, the page where it is small.

const LARGE = window.matchMedia("(min-width: 861px) and (min-height: 560px)"); // as in library.css
const [BELOW_HEAD, ABOVE_FOOT] = [132, 84]; // px of the page's head, and of the bar of actions

export class Scroll {
  constructor(pane) {
    this.pane = pane;
  }

  get isPane() {
    return LARGE.matches;
  }

  get top() {
    return this.isPane ? this.pane.scrollTop : window.scrollY;
  }

  /** What of the window shows the list, px from its top; free: what nothing lies over. */
  view(free = false) {
    if (!this.isPane) return free ? [BELOW_HEAD, window.innerHeight - ABOVE_FOOT] : [0, window.innerHeight];
    const { top, bottom } = this.pane.getBoundingClientRect();
    return [top + (free ? 4 : 0), bottom - (free ? 4 : 0)];
  }

  to(top) {
    (this.isPane ? this.pane : window).scrollTo({ top, behavior: "instant" });
  }

  by(px) {
    this.to(this.top + px);
  }

  /** Bring the beginning of an element, or a place `px` below it, to the top. */
  toElement(element, px = 0) {
    const [from] = this.view();
    this.by(element.getBoundingClientRect().top + px - from - (this.isPane ? 0 : 116));
  }

  onScroll(action) {
    for (const one of [window, this.pane]) one.addEventListener("scroll", action, { passive: true });
    LARGE.addEventListener("change", action);
  }
}
