// The list of clips as far as it is looked at: pages of it by offset, and the figures of what is near the window.
// What is far away is forgotten, so that ten thousand clips take no more memory than a few hundred.

import { get, getFigures } from "../core/api.js";

const PAGE = 100; // clips in one answer
const NEAR = 4; // pages kept before and behind what is seen
const MOST_FIGURES = 600;
const AT_ONCE = 120; // figures in one answer
const PAUSE = 60; // ms between two requests while the page scrolls

function read(query, page) {
  const asked = new URLSearchParams(query);
  asked.set("offset", String(page * PAGE));
  asked.set("limit", String(PAGE));
  return get(`/clips?${asked}`);
}

export class Source {
  /** hooks: reset(answer) when the list is another one, arrived() when something of it came, failed(error) */
  constructor(hooks) {
    Object.assign(this, { hooks, query: new URLSearchParams(), wanted: new URLSearchParams(), asking: null });
    Object.assign(this, { pages: new Map(), asked: new Set(), figures: new Map(), range: [0, 0], total: 0, round: 0 });
  }

  /** Another filter, or the same once more. The list stays what it is, to look at and to choose from, until the answer. */
  async ask(query = this.wanted) {
    const asking = (this.asking = Symbol("ask"));
    const wanted = (this.wanted = new URLSearchParams(query));
    // Of the same list what is seen is read too, so that nothing of it is away for a moment.
    const seen = String(wanted) === String(this.query) ? this.pagesOf(this.range).filter((page) => page > 0) : [];
    try {
      const [answer, ...others] = await Promise.all([0, ...seen].map((page) => read(wanted, page)));
      if (asking !== this.asking) return;
      const { total, revision } = answer;
      const pages = new Map([[0, answer.items]]);
      others.forEach((other, number) => other.revision === revision && pages.set(seen[number], other.items));
      Object.assign(this, { query: wanted, pages, asked: new Set(), total, revision, round: this.round + 1 });
      this.hooks.reset(answer);
    } finally {
      if (asking === this.asking) this.asking = null;
    }
  }

  async refresh() {
    const round = this.round;
    const { revision } = await get("/clips", { limit: 0 });
    if (!this.asking && round === this.round && revision !== this.revision) await this.ask();
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

  pagesOf([first, last]) {
    const numbers = [];
    for (let page = Math.floor(first / PAGE); page * PAGE < Math.min(last, this.total); page += 1) numbers.push(page);
    return numbers;
  }

  async fetchPages(range) {
    const numbers = this.pagesOf(range);
    this.forget(numbers[0] ?? 0);
    await Promise.all(numbers.filter((page) => !this.pages.has(page) && !this.asked.has(page)).map((page) => this.load(page)));
  }

  async load(page) {
    const round = this.round;
    this.asked.add(page);
    try {
      const answer = await read(this.query, page);
      if (round !== this.round) return;
      if (answer.revision === this.revision) {
        this.pages.set(page, answer.items);
        this.hooks.arrived();
      } else if (!this.asking) await this.ask();
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
    const came = await getFigures(wanted);
    wanted.forEach((id, number) => this.figures.set(id, came[number]));
    for (const id of this.figures.keys()) {
      if (this.figures.size <= MOST_FIGURES) break;
      this.figures.delete(id);
    }
    this.hooks.arrived();
  }

  forget(page) {
    for (const known of this.pages.keys()) if (known > 0 && Math.abs(known - page) > NEAR) this.pages.delete(known);
  }
}
