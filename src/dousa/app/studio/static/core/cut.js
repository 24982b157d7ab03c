// Text of one line that is cut in its middle where there is no room: names that begin alike differ at their ends.

import { h } from "./dom.js";

const TAIL = 10; // characters that always stay

export class CutText {
  /** element: gets the text, which stays whole for who reads or copies it; tail: characters that always stay */
  constructor(element, tail = TAIL) {
    this.length = tail;
    this.head = h("span", { class: "cut-head" });
    this.tail = h("span", { class: "cut-tail" });
    element.classList.add("cut");
    element.replaceChildren(this.head, this.tail);
  }

  set(text) {
    const at = text.length > 1.5 * this.length ? text.length - this.length : text.length;
    this.head.textContent = text.slice(0, at);
    this.tail.textContent = text.slice(at);
  }
}

/** An element's text, cut in the middle; -> the element. */
export function cutMiddle(element, text) {
  new CutText(element).set(text);
  return element;
}

/** A name in pieces, so that a line of it ends behind a separator or before a capital letter, and not anywhere. */
export const breakable = (name) => name.replace(/[_\-.\/\\ ]|[a-z](?=[A-Z])/g, "$&\0").split("\0").flatMap((piece) => [piece, h("wbr", {})]);
