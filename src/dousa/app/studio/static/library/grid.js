// A grid of which only the rows near what is seen exist. It has the height of all rows, and what it lies in scrolls.
// Arrow keys move between the cells, one of which can be reached by Tab.

import { CutText } from "../core/cut.js";
import { formatSeconds, h, icon, t } from "../core/dom.js";
import { FAVOURITE } from "./tags.js";

// One clip in the grid: its figure, its label, its name. Cells are used again for other clips as the page scrolls.
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

const GAP = 12;
const TEXT = 68; // px of a cell below its figure
const LIST_ROW = 56; // px with the gap
const BEYOND = 1; // rows kept ready above and below what is seen
const AHEAD = 3; // rows whose figures are asked for ahead

export class Grid {
  /** hooks: chosen(id) -> bool, acts on click(index, event), open(index), key(event, index) -> true if it was used */
  constructor(element, scroll, source, hooks) {
    Object.assign(this, { element, scroll, source, hooks, total: 0, columns: 0, active: 0, rows: new Map(), spare: [] });
    Object.assign(this, { size: 158, list: false, row: 226 });
    const wake = () => this.request();
    scroll.onScroll(wake); // rows that stay are not looked at
    new ResizeObserver(() => this.layout()).observe(element);
    window.addEventListener("resize", wake);
    element.addEventListener("click", (event) => this.withCell(event, (cell) => this.click(cell, event)));
    element.addEventListener("dblclick", (event) => event.target.closest(".tick") || this.withCell(event, (cell) => hooks.open(cell.index)));
    element.addEventListener("keydown", (event) => this.keydown(event));
    element.addEventListener("focusin", (event) => this.withCell(event, (cell) => this.activate(cell.index)));
    this.layout();
  }

  /** How the cells look: size is the least width of one in px, list a row for each. */
  setLook({ size, list }) {
    const top = this.columns ? this.seen()[0] * this.columns : 0;
    const figure = Math.round(0.92 * size);
    Object.assign(this, { size, list, row: list ? LIST_ROW : figure + TEXT + GAP, columns: 0 });
    this.element.classList.toggle("list", list);
    this.element.style.setProperty("--figure", `${figure}px`);
    this.layout();
    if (top > 0) this.reveal(top);
  }

  reveal(index) {
    this.scroll.toElement(this.element, Math.floor(index / this.columns) * this.row);
  }

  layout() {
    if (!this.element.clientWidth && this.columns) return; // the map is shown
    const columns = this.list ? 1 : Math.max(Math.floor((this.element.clientWidth + GAP) / (this.size + GAP)), 1);
    if (columns !== this.columns) {
      const focused = this.element.contains(document.activeElement);
      this.columns = columns;
      this.element.style.setProperty("--columns", String(columns));
      this.element.setAttribute("aria-colcount", String(columns));
      for (const row of [...this.rows.values(), ...this.spare]) this.drop(row);
      this.rows.clear();
      this.spare = [];
      this.measure();
      if (focused) this.focus(this.active);
    }
    this.request();
  }

  setTotal(total) {
    this.total = total;
    this.active = Math.min(this.active, Math.max(total - 1, 0));
    this.measure();
    this.stale = true;
    this.render();
  }

  measure() {
    this.rowCount = Math.ceil(this.total / this.columns);
    this.element.style.height = `${Math.max(this.rowCount * this.row - GAP, 0)}px`;
    this.element.setAttribute("aria-rowcount", String(this.rowCount));
  }

  /** Draw with the next frame; `renew` when what the rows show may have changed. */
  request(renew = false) {
    this.stale ||= renew;
    this.waiting ??= requestAnimationFrame(() => this.render());
  }

  seen() {
    const [from, to] = this.scroll.view();
    const own = this.element.getBoundingClientRect().top;
    const top = from - own;
    const first = Math.max(Math.floor(top / this.row), 0);
    return [Math.min(first, this.rowCount), Math.max(Math.min(Math.ceil((to - own) / this.row), this.rowCount), 0)];
  }

  render() {
    cancelAnimationFrame(this.waiting);
    this.waiting = undefined;
    const [first, last] = this.seen();
    const wanted = new Set();
    for (let row = Math.max(first - BEYOND, 0); row < Math.min(last + BEYOND, this.rowCount); row += 1) wanted.add(row);
    // The focus must not fall into nothing, nor onto another clip.
    if (this.element.contains(document.activeElement) && this.total) wanted.add(Math.floor(this.active / this.columns));
    for (const [number, row] of this.rows) {
      if (wanted.has(number)) continue;
      this.rows.delete(number);
      this.spare.push(row);
      row.element.hidden = true;
    }
    for (const number of wanted) {
      const row = this.rows.get(number);
      if (!row || this.stale) this.fill(row ?? this.place(number), number);
    }
    this.stale = false;
    while (this.spare.length > 2 * BEYOND + 2) this.drop(this.spare.pop());
    this.source.need(Math.max(first - AHEAD, 0) * this.columns, Math.min((last + AHEAD) * this.columns, this.total));
  }

  place(number) {
    const row = this.spare.pop() ?? this.make();
    row.element.hidden = false;
    row.element.style.transform = `translateY(${number * this.row}px)`;
    row.element.setAttribute("aria-rowindex", String(number + 1));
    this.rows.set(number, row);
    return row;
  }

  make() {
    const cells = Array.from({ length: this.columns }, () => new Cell());
    const element = h("div", { class: "grid-row", role: "row" }, ...cells.map((cell) => cell.element));
    cells.forEach((cell, column) => {
      cell.element.cell = cell;
      cell.element.setAttribute("aria-colindex", String(column + 1));
    });
    this.element.append(element);
    return { element, cells };
  }

  drop(row) {
    for (const cell of row.cells) cell.destroy();
    row.element.remove();
  }

  fill(row, number) {
    row.cells.forEach((cell, column) => {
      const index = number * this.columns + column;
      if (index >= this.total) {
        cell.show(null, undefined, undefined);
        return;
      }
      const clip = this.source.item(index);
      cell.show(index, clip, clip && this.source.figure(clip.id));
      cell.mark(Boolean(clip) && this.hooks.chosen(clip.id), index === this.active);
    });
  }

  withCell(event, action) {
    const cell = event.target.closest(".cell")?.cell;
    if (cell && cell.index !== null) action(cell);
  }

  click(cell, event) {
    if (cell.id === null) return;
    this.activate(cell.index);
    this.hooks.click(cell.index, event);
  }

  activate(index) {
    if (index === this.active) return;
    this.cellAt(this.active)?.element.setAttribute("tabindex", "-1");
    this.active = index;
    this.cellAt(index)?.element.setAttribute("tabindex", "0");
  }

  cellAt(index) {
    return this.rows.get(Math.floor(index / this.columns))?.cells[index % this.columns];
  }

  keydown(event) {
    const [from, to] = this.scroll.view(true);
    const page = Math.max(Math.floor((to - from) / this.row), 1);
    const rowStart = this.active - (this.active % this.columns);
    const steps = {
      ArrowLeft: this.active - 1,
      ArrowRight: this.active + 1,
      ArrowUp: this.active - this.columns,
      ArrowDown: this.active + this.columns,
      PageUp: this.active - page * this.columns,
      PageDown: this.active + page * this.columns,
      Home: event.ctrlKey ? 0 : rowStart,
      End: event.ctrlKey ? this.total - 1 : rowStart + this.columns - 1,
    };
    if (!this.total) return;
    if (event.key in steps) {
      event.preventDefault();
      const to = Math.min(Math.max(steps[event.key], 0), this.total - 1);
      this.focus(to);
      if (event.shiftKey) this.hooks.click(to, event);
      return;
    }
    if (this.hooks.key(event, this.active)) event.preventDefault();
  }

  focus(index) {
    if (!this.total) return;
    this.activate(index);
    const top = this.element.getBoundingClientRect().top + Math.floor(index / this.columns) * this.row;
    const [above, below] = this.scroll.view(true);
    if (top < above) this.scroll.by(top - above);
    else if (top + this.row > below) this.scroll.by(top + this.row - below);
    const row = Math.floor(index / this.columns);
    if (!this.rows.has(row)) this.fill(this.place(row), row);
    this.cellAt(index).element.focus({ preventScroll: true });
    this.render();
  }
}
