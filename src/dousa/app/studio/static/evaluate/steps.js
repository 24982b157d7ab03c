// Changes of figures and weights that are taken back and done again, as long as the evaluation is shown.

const MOST = 200;

export class Steps {
  /** hooks: read() -> what is shown now, show(what), changed({back, forth}: whether there is a step) */
  constructor(hooks) {
    Object.assign(this, { hooks, kept: [], at: 0, going: false });
    this.press = (event) => {
      const key = event.key.toLowerCase();
      const by = key === "z" ? (event.shiftKey ? 1 : -1) : key === "y" ? 1 : 0;
      if (!by || !(event.ctrlKey || event.metaKey) || event.altKey || event.target.closest?.("input:not([type=range], [type=checkbox]), textarea, select, dialog")) return;
      event.preventDefault();
      this.go(by);
    };
    document.addEventListener("keydown", this.press);
  }

  begin() {
    this.kept = [this.hooks.read()];
  }

  /** Something may have changed. */
  note() {
    if (this.going || !this.kept.length) return;
    const now = this.hooks.read();
    if (JSON.stringify(now) === JSON.stringify(this.kept[this.at])) return;
    this.kept = [...this.kept.slice(0, this.at + 1), now].slice(-MOST);
    this.at = this.kept.length - 1;
    this.tell();
  }

  go(by) {
    const wanted = this.kept[this.at + by];
    if (!wanted) return;
    this.at += by;
    this.going = true;
    this.hooks.show(wanted);
    this.going = false;
    this.tell();
  }

  tell() {
    this.hooks.changed({ back: this.at > 0, forth: this.at < this.kept.length - 1 });
  }

  end() {
    document.removeEventListener("keydown", this.press);
  }
}
