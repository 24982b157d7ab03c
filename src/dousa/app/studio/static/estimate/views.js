// Silhouette and model of every view at one frame; a picture stays until the next one is there.

import { h, t } from "../core/dom.js";

export class Views {
  /** views: [{name, width, height}] */
  constructor(place, job, views) {
    this.job = job;
    this.wanted = null;
    this.cells = views.map((view, index) => new Cell(job, view, index));
    const columns = chooseColumns(views);
    place.style.setProperty("--columns", String(columns));
    place.style.setProperty("--highest", `${Math.floor(56 / Math.ceil(views.length / columns))}vh`);
    place.replaceChildren(...this.cells.map((cell) => cell.element));
  }

  /** known: {overlaps, lost, stage} of the frame; version: changes when its drawing does. */
  show(frame, known) {
    const version = `${known.stage}`;
    for (const [index, cell] of this.cells.entries()) cell.show(frame, version, known.overlaps[index], known.lost);
  }
}

/** Wide pictures two beside each other (three of six or nine), tall ones four. */
function chooseColumns(views) {
  const isTall = views[0].height > views[0].width;
  if (isTall || views.length === 1) return Math.min(views.length, 4);
  return views.length <= 4 || views.length % 3 ? 2 : 3;
}

class Cell {
  constructor(job, view, index) {
    Object.assign(this, { job, view, index, busy: false, next: null, shown: null });
    this.picture = h("div", { class: "picture", style: {} }, t("view_waiting"));
    this.picture.style.setProperty("--shape", `${view.width} / ${view.height}`);
    this.value = h("span", {});
    this.mark = h("span", { class: "lost-mark", hidden: true }, t("lost"));
    this.element = h("figure", { class: "view", dataset: { view: view.name } }, this.picture, this.mark, h("figcaption", {}, h("b", {}, view.name), this.value));
  }

  show(frame, version, overlap, lost) {
    const key = `${frame}.${version}`;
    this.next = key === this.shown ? null : { frame, version, key, overlap, lost };
    if (!this.busy && this.next) this.load();
  }

  // One picture at a time: whoever plays faster than pictures come sees fewer of them, not old ones.
  async load() {
    const { frame, version, key, overlap, lost } = this.next;
    this.next = null;
    this.busy = true;
    const said = overlap === null ? "-" : overlap.toFixed(2);
    const image = h("img", { alt: t("view_picture", { name: this.view.name, frame: frame + 1, overlap: said }) });
    image.src = `/api/estimations/${this.job}/overlay/${this.index}/${frame}?stage=${version}`;
    try {
      await image.decode();
      this.picture.replaceChildren(image);
      this.value.textContent = overlap === null ? t("no_image") : t("overlap_value", { value: said });
      this.mark.hidden = !lost;
      this.element.classList.toggle("lost", lost);
      this.element.dataset.frame = String(frame);
      this.shown = key;
    } catch {
      // the job was forgotten, or the studio is away: what is shown stays
    }
    this.busy = false;
    if (this.next) this.load();
  }
}
