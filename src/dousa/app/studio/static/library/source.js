// The list of clips as far as it is looked at: pages of it by offset, and the figures of what is near the window.
// What is far away is forgotten, so that ten thousand clips take no more memory than a few hundred.

import { get, postForBytes } from "../core/api.js";

const PAGE = 100; // clips in one answer
const NEAR = 4; // pages kept before and behind what is seen
const FIGURE_BYTES = 1456;
const MOST_FIGURES = 600;
const AT_ONCE = 120; // figures in one answer
const PAUSE = 60; // ms between two requests while the page scrolls

export class Source {
  /** hooks: reset(answer) when the list is another one, arrived() when something of it came, failed(error) */
  constructor(hooks) {
    this.hooks = hooks;
    this.figures = new Map();
    this.range = [0, 0];
    this.clear(new URLSearchParams());
  }

  clear(query) {
    this.query = query;
    this.pages = new Map();
    this.asked = new Set();
    this.round = (this.round ?? 0) + 1;
    this.total = this.total ?? 0;
  }

  /** Another filter, or the same once more. */
  async ask(query = this.query) {
    this.clear(query);
    const round = this.round;
    const answer = await this.load(0);
    if (answer && round === this.round) {
      this.total = answer.total;
      this.revision = answer.revision;
      this.hooks.reset(answer);
    }
  }

  /** Look whether somebody has changed the library. */
  async refresh() {
    const round = this.round;
    const { revision } = await get("/clips", { limit: 0 });
    if (round === this.round && revision !== this.revision) await this.ask();
  }

  item(index) {
    return this.pages.get(Math.floor(index / PAGE))?.[index % PAGE];
  }

  /** Bytes of the figure of a clip; null if it cannot be drawn, undefined if it is not here yet. */
  figure(id) {
    return this.figures.get(id);
  }

  /** What is seen or soon will be: clips from first to last, not including it. */
  need(first, last) {
    this.range = [first, last];
    if (this.timer || this.fetching) return; // what is under way looks at the range when it is done
    const wait = performance.now() - (this.fetched ?? -Infinity) > PAUSE ? 0 : PAUSE;
    this.timer = setTimeout(() => this.fetch(), wait);
  }

  async fetch() {
    this.timer = 0;
    this.fetching = true;
    const range = this.range;
    try {
      await this.fetchPages(range);
      await this.fetchFigures(range);
    } catch (error) {
      this.hooks.failed(error);
    }
    this.fetching = false;
    this.fetched = performance.now();
    if (range !== this.range) this.need(...this.range);
  }

  async fetchPages([first, last]) {
    const numbers = [];
    for (let page = Math.floor(first / PAGE); page * PAGE < Math.min(last, this.total); page += 1) numbers.push(page);
    this.forget(numbers[0] ?? 0);
    await Promise.all(numbers.filter((page) => !this.pages.has(page) && !this.asked.has(page)).map((page) => this.load(page)));
  }

  async load(page) {
    const round = this.round;
    this.asked.add(page);
    const query = new URLSearchParams(this.query);
    query.set("offset", String(page * PAGE));
    query.set("limit", String(PAGE));
    try {
      const answer = await get(`/clips?${query}`);
      if (round !== this.round) return null;
      if (page > 0 && answer.revision !== this.revision) {
        await this.ask();
        return null;
      }
      this.pages.set(page, answer.items);
      if (page > 0) this.hooks.arrived();
      return answer;
    } finally {
      if (round === this.round) this.asked.delete(page);
    }
  }

  async fetchFigures([first, last]) {
    const wanted = [];
    for (let index = first; index < last && wanted.length < AT_ONCE; index += 1) {
      const clip = this.item(index);
      if (clip && !this.figures.has(clip.id)) wanted.push(clip.id);
    }
    if (!wanted.length) return;
    this.keep(wanted, await postForBytes("/clips/thumbnails", { clips: wanted }));
    this.hooks.arrived();
  }

  keep(ids, buffer) {
    ids.forEach((id, number) => {
      // A copy, so that one figure does not hold the bytes of all.
      const bytes = new Uint8Array(buffer.slice(number * FIGURE_BYTES, (number + 1) * FIGURE_BYTES));
      this.figures.delete(id);
      this.figures.set(id, bytes.some(Boolean) ? bytes : null);
    });
    for (const id of this.figures.keys()) {
      if (this.figures.size <= MOST_FIGURES) break;
      this.figures.delete(id);
    }
  }

  forget(page) {
    for (const known of this.pages.keys()) if (known > 0 && Math.abs(known - page) > NEAR) this.pages.delete(known);
  }
}
