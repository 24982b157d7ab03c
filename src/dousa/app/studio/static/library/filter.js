// What the list is filtered by; it stands in the address, so that a reload or a link shows the same.

const SINGLE = ["text", "wide", "kind", "min_s", "max_s", "batch", "saved", "sort"];
const SEVERAL = ["category", "performer", "tag"];

export class Filter {
  constructor(changed) {
    this.changed = changed;
    const asked = new URLSearchParams(location.search);
    this.query = new URLSearchParams();
    for (const name of SINGLE) if (asked.get(name)) this.query.set(name, asked.get(name));
    for (const name of SEVERAL) for (const value of asked.getAll(name)) this.query.append(name, value);
  }

  get(name) {
    return this.query.get(name) ?? "";
  }

  has(name, value) {
    return this.query.getAll(name).includes(value);
  }

  get narrows() {
    return [...this.query.keys()].some((name) => name !== "sort" && name !== "wide");
  }

  set(values) {
    for (const [name, value] of Object.entries(values)) {
      if (value === null || value === "") this.query.delete(name);
      else this.query.set(name, value);
    }
    this.tell();
  }

  toggle(name, value) {
    const others = this.query.getAll(name);
    this.query.delete(name);
    const wanted = others.includes(value) ? others.filter((other) => other !== value) : [...others, value];
    for (const one of wanted) this.query.append(name, one);
    this.tell();
  }

  /** Values of something that several may be chosen of. */
  setAll(name, values) {
    this.query.delete(name);
    for (const value of values) this.query.append(name, value);
    this.tell();
  }

  /** Another filter as a whole, such as one that was kept. */
  replace(values) {
    const sort = this.get("sort");
    this.query = new URLSearchParams(sort ? { sort } : {});
    for (const [name, value] of Object.entries(values)) for (const one of [value].flat()) if (one !== null) this.query.append(name, String(one));
    this.tell();
  }

  clear() {
    const sort = this.get("sort");
    this.query = new URLSearchParams(sort ? { sort } : {});
    this.tell();
  }

  tell() {
    const address = new URL(location.href);
    for (const name of [...SINGLE, ...SEVERAL]) address.searchParams.delete(name);
    for (const [name, value] of this.query) address.searchParams.append(name, value);
    history.replaceState(null, "", address);
    this.changed();
  }
}
