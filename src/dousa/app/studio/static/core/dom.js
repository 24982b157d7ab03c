// Elements and words. Text always goes in as text.

const words = JSON.parse(document.getElementById("words").textContent);

/** A word of the page's language; {names} are filled in, and of {name:clip|clips} the first is taken where it is 1. */
export function t(name, values = {}) {
  const word = words[name] ?? name;
  const numbered = word.replace(/\{(\w+):([^{}|]*)\|([^{}]*)\}/g, (whole, key, one, many) => (String(values[key]) === "1" ? one : many));
  return numbered.replace(/\{(\w+)\}/g, (whole, key) => (key in values ? String(values[key]) : whole));
}

export const language = document.documentElement.lang;

/** Formats whole numbers in the language of the page. */
export const count = new Intl.NumberFormat(language);

/** Element: h("button", {class: "small", onclick: act, "aria-label": "x", hidden: false}, "text", child, ...). */
export function h(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties ?? {})) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "class") element.className = value;
    else if (name === "dataset") Object.assign(element.dataset, value);
    else if (name === "style") Object.assign(element.style, value);
    else if (name in element && typeof value !== "string") element[name] = value;
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
  return element;
}

export const $ = (selector, root = document) => root.querySelector(selector);
export const $$ = (selector, root = document) => [...root.querySelectorAll(selector)];

const SVG = "http://www.w3.org/2000/svg";

const SHAPES = {
  play: "M7 4.5v15l12.5-7.5z",
  pause: "M6 4.5h4.5v15H6zM13.5 4.5H18v15h-4.5z",
  close: "M6 4.6 12 10.6l6-6L19.4 6l-6 6 6 6L18 19.4l-6-6-6 6L4.6 18l6-6-6-6z",
  sun: "M12 7a5 5 0 1 0 .01 0zM11 1h2v4h-2zM11 19h2v4h-2zM1 11h4v2H1zM19 11h4v2h-4zM4.2 5.6l1.4-1.4 2.8 2.8L7 8.4zM15.6 17l1.4-1.4 2.8 2.8-1.4 1.4zM5.6 19.8l-1.4-1.4L7 15.6 8.4 17zM17 8.4 15.6 7l2.8-2.8 1.4 1.4z",
  moon: "M20.5 14.5A8.8 8.8 0 0 1 9.5 3.5a8.8 8.8 0 1 0 11 11z",
  half: "M12 2a10 10 0 1 0 .01 0zm0 2.2v15.6a7.8 7.8 0 0 1 0-15.6z",
  search: "M10.5 3a7.5 7.5 0 1 0 4.7 13.4l4.7 4.7 1.5-1.5-4.7-4.7A7.5 7.5 0 0 0 10.5 3zm0 2.2a5.3 5.3 0 1 1 0 10.6 5.3 5.3 0 0 1 0-10.6z",
  download: "M11 3h2v9l3.3-3.3 1.4 1.4L12 15.8l-5.7-5.7 1.4-1.4L11 12zM4 18h16v2.2H4z",
  upload: "M11 16V7L7.7 10.3 6.3 8.9 12 3.2l5.7 5.7-1.4 1.4L13 7v9zM4 18h16v2.2H4z",
  folder: "M3 5h6l2 2.4h10V19H3z",
  trash: "M9 3h6v2h5v2.2H4V5h5zM6 9h12l-1 12H7z",
  tag: "M3 3h9l9 9-9 9-9-9zm4.5 3A1.6 1.6 0 1 0 7.51 6z",
  label: "M4 17.2V20h2.8L17.4 9.4l-2.8-2.8zM19.6 7.2a1 1 0 0 0 0-1.4l-1.4-1.4a1 1 0 0 0-1.4 0l-1.2 1.2 2.8 2.8z",
  star: "M12 3l2.7 5.9 6.4.7-4.8 4.3 1.4 6.3L12 17l-5.7 3.2 1.4-6.3-4.8-4.3 6.4-.7z",
  next: "M8.6 5 10 3.6l8.4 8.4-8.4 8.4L8.6 19l7-7z",
  undo: "M9 5 3 11l6 6v-4h5a4 4 0 0 1 0 8h-3v2h3a6 6 0 0 0 0-12H9z",
  mark: "M4 12.5 9.5 18 20 6.5 18.4 5 9.4 14.9 5.5 11z",
};

/** Small drawing: play pause close sun moon half search download upload folder trash tag label star undo mark next. */
export function icon(name) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "0 0 24 24");
  svg.setAttribute("aria-hidden", "true");
  svg.setAttribute("class", "icon-shape");
  const path = document.createElementNS(SVG, "path");
  path.setAttribute("d", SHAPES[name]);
  path.setAttribute("fill-rule", "evenodd");
  svg.append(path);
  return svg;
}

/** "3.2 s", "1:04", "1:02:03" */
export function formatSeconds(seconds) {
  if (seconds < 59.95) return t("seconds", { value: seconds.toFixed(1) });
  const whole = Math.round(seconds);
  const two = (value) => String(value).padStart(2, "0");
  const [hours, minutes, rest] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  return hours ? `${hours}:${two(minutes)}:${two(rest)}` : `${minutes}:${two(rest)}`;
}

export const percent = (share) => Math.round(100 * share);

/** A grade of an answer, as reports and tables say it: half a point up. */
export const wholeGrade = (score) => String(Math.floor(score + 0.5));

export const baseName = (path) => path.split(/[\\/]/).pop();

/** act(share of the width, share of the height) where an element is pressed, and while the pointer is dragged from there. */
export function onDrag(element, act) {
  const tell = (event) => {
    const box = element.getBoundingClientRect();
    act((event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height);
  };
  element.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    element.setPointerCapture(event.pointerId);
    tell(event);
  });
  element.addEventListener("pointermove", (event) => event.buttons && tell(event));
}

/** -> a picture that can be drawn, or null where there is none */
export async function decode(address) {
  const image = Object.assign(new Image(), { src: address });
  return image.decode().then(() => image, () => null);
}

/** What the browser keeps for a page, in "localStorage" or "sessionStorage"; null if nothing of ours is there. */
export function recall(storage, key) {
  try {
    return JSON.parse(window[storage].getItem(key));
  } catch {
    return null;
  }
}

/** Keep a value there; without room, or where nothing may be kept, it lasts as long as the page. */
export function keep(storage, key, value) {
  try {
    window[storage].setItem(key, JSON.stringify(value));
  } catch {
    // nothing to be done
  }
}

/** Calls after `wait` ms without another call. */
export function later(action, wait) {
  let timer = 0;
  return (...values) => {
    clearTimeout(timer);
    timer = setTimeout(() => action(...values), wait);
  };
}
