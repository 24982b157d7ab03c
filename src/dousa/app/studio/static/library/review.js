// Clips whose label is likely wrong, one after the other, decided by keys; and groups of clips that are nearly the same.

import { get, getFigures, post } from "../core/api.js";
import { openDialog } from "../core/dialog.js";
import { count, h, percent, t } from "../core/dom.js";
import { followJob, isActive } from "../core/jobs.js";
import { attempt, notify } from "../core/notices.js";
import { inAddress } from "./places.js";
import { waiting } from "./waiting.js";

const CHECKED = "checked"; // tag of clips whose label is right
const MOST_GROUPS = 60;

/** jobId: of a review that was made, null to make one. hooks: changed(), choose(ids), look(clip number) */
export async function openReview(jobId, hooks) {
  const body = h("div", { class: "stack rv" });
  let [end, queue] = [() => {}, null];
  const { dialog, close } = openDialog(t("review_title"), body, {
    wide: true,
    onClose: () => {
      end();
      queue?.destroy();
      inAddress({ job: null });
      hooks.changed();
    },
  });
  dialog.addEventListener("keydown", (event) => queue?.press(event));
  // One that is being made already is waited for, and not made a second time.
  const begin = async () => (await get("/jobs", { kind: "review", active: true })).jobs[0] ?? post("/jobs/review");
  const id = jobId ?? (await attempt(begin))?.id;
  if (!id) {
    close();
    return;
  }
  inAddress({ job: id });
  end = followJob(id, (job) => {
    if (isActive(job)) body.replaceChildren(...waiting(job, job.what || t("waits"), close));
    else if (!job.result) body.replaceChildren(h("p", { class: "problem-box" }, job.problem ?? t("adding_stopped")));
    else if (!queue) {
      queue = new Queue(job.result, { ...hooks, close });
      body.replaceChildren(queue.element);
      dialog.tabIndex = -1;
      dialog.focus(); // keys are for the queue
    }
  });
}

class Queue {
  constructor({ doubts, duplicates, n_judged: judged }, hooks) {
    Object.assign(this, { doubts, duplicates, judged, hooks, at: 0, done: [], figures: [], busy: false });
    this.stage = h("div", { class: "rv-stage" });
    this.element = h("div", { class: "stack" }, this.stage, this.groups());
    this.show();
  }

  async show() {
    for (const one of this.figures) one.destroy();
    this.figures = [];
    // What was decided elsewhere meanwhile is not asked again.
    while (this.at < this.doubts.length && !(await this.isOpen(this.doubts[this.at]))) this.at += 1;
    const doubt = this.doubts[this.at];
    if (!doubt) {
      this.stage.replaceChildren(h("p", { class: "empty", id: "review-end", role: "status" }, t(this.doubts.length ? "review_end" : "review_none", { count: count.format(this.judged), done: count.format(this.done.length) })), ...(this.done.length ? [this.button("undo", "undo", "U")] : []));
      return;
    }
    this.stage.replaceChildren(
      h("p", { class: "note", role: "status", id: "review-count" }, t("review_count", { at: count.format(this.at + 1), total: count.format(this.doubts.length) })),
      h("div", { class: "rv-pair" },
        h("div", { class: "rv-own" }, this.figure(doubt.clip_id, "rv-large"), h("p", { class: "rv-name" }, this.clip.name), h("p", { class: "note" }, this.clip.folder)),
        h("div", { class: "stack" }, this.side("review_like", doubt.suggested, doubt.votes, doubt.alike), this.side("review_labelled", doubt.category, doubt.own_votes, doubt.same))),
      h("div", { class: "row rv-acts" },
        this.button("yes", "review_yes", "Y", { suggested: doubt.suggested }), this.button("no", "review_no", "N", { category: doubt.category }), this.button("skip", "review_skip", "S"),
        ...(this.done.length ? [this.button("undo", "undo", "U")] : [])),
    );
    this.draw(); // keys do not wait for pictures
  }

  async isOpen(doubt) {
    this.clip = await get(`/clips/${doubt.clip_id}`).catch(() => null);
    return this.clip !== null && this.clip.category === doubt.category && !this.clip.tags.includes(CHECKED);
  }

  side(word, category, share, clips) {
    return h("section", { class: "rv-side" }, h("h3", {}, t(word, { category })), h("p", { class: "note" }, t("review_votes", { percent: percent(share) })), h("div", { class: "rv-row" }, ...clips.map((id) => this.figure(id, "rv-small"))));
  }

  button(act, word, key, values = {}) {
    const kind = act === "yes" ? "primary" : act === "undo" ? "quiet" : "";
    return h("button", { type: "button", class: kind, id: `review-${act}`, "aria-keyshortcuts": key, onclick: () => this.act(act) }, t(word, values), h("kbd", {}, key));
  }

  figure(id, kind) {
    return h("canvas", { class: kind, dataset: { clip: String(id) } });
  }

  async draw(root = this.stage) {
    const open = [...root.querySelectorAll("canvas[data-clip]:not([data-drawn])")];
    if (!open.length) return;
    for (const canvas of open) canvas.dataset.drawn = "1";
    const figures = await attempt(() => getFigures(open.map((canvas) => Number(canvas.dataset.clip))));
    open.forEach((canvas, place) => {
      if (figures?.[place] && canvas.isConnected) this.figures.push(window.dousa.createMiniature(canvas, figures[place]));
    });
  }

  press(event) {
    if (event.altKey || event.target.closest("input, select, textarea, summary")) return;
    const key = event.key.toLowerCase();
    const acts = event.ctrlKey || event.metaKey ? { z: "undo" } : { y: "yes", n: "no", s: "skip", u: "undo", arrowright: "skip" };
    if (!(key in acts)) return;
    event.preventDefault();
    if (!event.repeat) this.act(acts[key]);
  }

  async act(name) {
    const doubt = this.doubts[this.at];
    if (this.busy || (!doubt && name !== "undo")) return;
    this.busy = true;
    await attempt(async () => {
      if (name === "undo") await this.undo();
      else {
        const clips = [doubt.clip_id];
        const answer = name === "yes" ? await post("/clips/relabel", { clips, category: doubt.suggested }) : name === "no" ? await post("/clips/tag", { clips, add: [CHECKED] }) : null;
        this.done.push({ at: this.at, change: answer?.change ?? null });
        this.at += 1;
      }
      await this.show();
    });
    this.busy = false;
  }

  async undo() {
    const last = this.done.pop();
    if (!last) return;
    if (last.change !== null) await post("/journal/undo", { number: last.change });
    this.at = last.at;
  }

  groups() {
    const { duplicates } = this;
    if (!duplicates.length) return h("p", { class: "note" }, t("review_no_duplicates"));
    const list = h("div", { class: "rv-groups" });
    const group = ({ clips, distance }) =>
      h("div", { class: "rv-group" },
        h("div", { class: "rv-row" }, ...clips.slice(0, 6).map((one) => h("figure", {}, this.figure(one.clip_id, "rv-small"), h("figcaption", { title: one.path }, one.path.split(/[\\/]/).pop())))),
        h("p", { class: "note" }, t("review_group", { count: clips.length, percent: (100 * distance).toFixed(1) })),
        h("button", { type: "button", class: "small", onclick: () => this.choose(clips.slice(1)) }, t("review_choose", { count: clips.length - 1 })));
    const all = h("button", { type: "button", class: "small", onclick: () => this.choose(duplicates.flatMap(({ clips }) => clips.slice(1))) }, t("review_choose_all", { count: count.format(duplicates.reduce((sum, { clips }) => sum + clips.length - 1, 0)) }));
    const details = h("details", { id: "review-duplicates" }, h("summary", {}, t("review_duplicates", { count: count.format(duplicates.length) })), h("div", { class: "row" }, all), list);
    details.addEventListener("toggle", () => {
      if (!details.open || list.children.length) return;
      list.replaceChildren(...duplicates.slice(0, MOST_GROUPS).map(group));
      this.draw(list);
    });
    return details;
  }

  choose(clips) {
    this.hooks.close();
    this.hooks.choose(clips.map((one) => one.clip_id));
    notify(t("review_chosen", { count: count.format(clips.length) }));
  }

  destroy() {
    for (const one of this.figures) one.destroy();
  }
}
