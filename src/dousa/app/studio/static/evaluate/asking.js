// Asking for what was changed: quickly while it changes, exactly when it rests; never two questions at once.

import { post } from "../core/api.js";

const REST = 450; // ms without a change before the exact answer is asked for

/** onAnswer(answer), onProblem(error), onBusy(bool) */
export class Asking {
  constructor(path, { onAnswer, onProblem, onBusy }) {
    Object.assign(this, { path, onAnswer, onProblem, onBusy, wanted: null, busy: false, timer: 0, ended: false });
  }

  /** Something is being changed; `done`: it is let go. */
  change(values, done) {
    this.wanted = { ...values, precision: "quick" };
    this.latest = values;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.settle(), done ? REST : 2 * REST);
    this.run();
  }

  settle() {
    this.wanted = { ...this.latest, precision: "exact" };
    this.run();
  }

  async run() {
    if (this.busy || !this.wanted || this.ended) return;
    const asked = this.wanted;
    this.wanted = null;
    this.busy = true;
    this.onBusy(true);
    try {
      const answer = await post(this.path, asked);
      if (!this.ended) this.onAnswer({ ...answer, kept: asked.precision === "exact" });
    } catch (error) {
      // The exact question would be answered by the same words again.
      if (!this.ended && asked.precision === "quick") clearTimeout(this.timer);
      if (!this.ended) this.onProblem(error);
    }
    this.busy = false;
    this.onBusy(false);
    this.run();
  }

  end() {
    this.ended = true;
    clearTimeout(this.timer);
  }
}
