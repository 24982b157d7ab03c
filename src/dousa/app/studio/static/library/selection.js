// Which clips are chosen: by number, whether they are on the page or far below.

export class Selection {
  /** hooks: changed(), idsBetween(first, last) -> promise of numbers, known(index) -> clip or undefined,
   *  findAgain(numbers) -> promise of [number, clip or null] */
  constructor(hooks) {
    this.hooks = hooks;
    this.clips = new Map(); // number -> clip, or null where only the number is known
    this.anchor = 0;
    this.hidden = 0; // of those that are chosen, how many the list does not show
  }

  get size() {
    return this.clips.size;
  }

  get ids() {
    return [...this.clips.keys()];
  }

  has(id) {
    return this.clips.has(id);
  }

  get single() {
    return this.size === 1 ? [...this.clips.values()][0] : null;
  }

  only(index) {
    const clip = this.hooks.known(index);
    if (!clip) return;
    this.anchor = index;
    this.hidden = 0;
    this.clips = new Map([[clip.id, clip]]);
    this.hooks.changed();
  }

  toggle(index) {
    const clip = this.hooks.known(index);
    if (!clip) return;
    this.anchor = index;
    if (!this.clips.delete(clip.id)) this.clips.set(clip.id, clip);
    this.hooks.changed();
  }

  async extend(index) {
    const [first, last] = [Math.min(this.anchor, index), Math.max(this.anchor, index)];
    const known = Array.from({ length: last - first + 1 }, (_, step) => this.hooks.known(first + step));
    const wish = (this.wish = Symbol("extend"));
    const pairs = known.every(Boolean) ? known.map((clip) => [clip.id, clip]) : await this.fetched(first, last);
    if (wish !== this.wish) return; // another key was pressed meanwhile
    this.hidden = 0;
    this.clips = new Map(pairs);
    this.hooks.changed();
  }

  async fetched(first, last) {
    return (await this.hooks.idsBetween(first, last)).map((id) => [id, this.clips.get(id) ?? null]);
  }

  all(ids) {
    this.hidden = 0;
    this.clips = new Map(ids.map((id) => [id, this.clips.get(id) ?? null]));
    this.hooks.changed();
  }

  restore(pairs) {
    this.clips = new Map(pairs);
    this.hooks.changed();
  }

  /** What is known of the chosen clips is what they are now; those that are gone are chosen no more. */
  async refresh() {
    if (!this.size) return;
    const asked = new Set(this.ids);
    const found = new Map(await this.hooks.findAgain([...asked]));
    const now = [...this.clips].filter(([id]) => found.has(id) || !asked.has(id)); // others may have been chosen meanwhile
    this.clips = new Map(now.map(([id, clip]) => [id, found.get(id) ?? clip]));
    this.hooks.changed();
  }

  clear() {
    if (!this.size) return;
    this.clips = new Map();
    this.hidden = 0;
    this.hooks.changed();
  }
}
