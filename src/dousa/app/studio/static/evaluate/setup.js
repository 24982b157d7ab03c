// The three steps before a grade: performance, takes of the reference, options.

import { get, post } from "../core/api.js";
import { $, h, t } from "../core/dom.js";
import { dropZone, MOTION_FILES } from "../core/drop.js";
import { takeMotions } from "../core/incoming.js";
import { attempt } from "../core/notices.js";
import { pickClips } from "../core/pick.js";
import { describeMotion, motionRow } from "./motions.js";
import { keepChoice, plain, whole } from "./state.js";

const MOST = 50;

const isSame = (a, b) => JSON.stringify(plain(a)) === JSON.stringify(plain(b));

const upload = async (entries) => (await takeMotions(entries)).map(whole);

/** onGrade(request) when somebody wants the grade. */
export class Setup {
  constructor(onGrade) {
    this.form = $("#setup");
    this.choice = { performance: null, references: [], side: "same", tempo: "same", repetitions: false };
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      if (this.isReady()) onGrade(this.request());
    });
    this.build();
  }

  isReady() {
    return Boolean(this.choice.performance) && this.choice.references.length > 0;
  }

  request() {
    const { performance, references, side, tempo, repetitions } = this.choice;
    return { performance: plain(performance), references: references.map(plain), side, tempo, repetitions };
  }

  /** Show a choice; it is kept in the address only when somebody changes it. */
  show(choice) {
    this.choice = { ...this.choice, ...choice };
    this.draw();
  }

  change(changes) {
    this.show(changes);
    keepChoice(this.choice);
  }

  add(refs) {
    const all = [...this.choice.references];
    for (const ref of refs) if (!all.some((one) => isSame(one, ref))) all.push(ref);
    this.change({ references: all.slice(0, MOST) });
    return all.length;
  }

  build() {
    const pickOne = async () => {
      const [clip] = await pickClips({});
      if (clip) this.change({ performance: whole(clip.motion ?? `clip:${clip.id}`) });
    };
    const pickMany = async () => this.add((await pickClips({ multiple: true })).map((clip) => whole(clip.motion ?? `clip:${clip.id}`)));
    const takeOne = async (entries) => {
      const [first, ...more] = await upload(entries);
      if (first) this.change({ performance: first });
      if (more.length) this.add(more);
    };
    this.performance = h("ul", { class: "motions", id: "performance-list" });
    this.references = h("ol", { class: "motions", id: "reference-list" });
    this.suggestion = h("p", { class: "note", role: "status" });
    const button = (id, word, act) => h("button", { type: "button", id, onclick: act }, t(word));
    this.suggestButton = button("suggest", "suggest", () => this.suggest());
    this.suggestButton.title = t("suggest_title");
    const zone = (id, word, take, ...buttons) => {
      const element = dropZone(take, { text: t(word), accept: MOTION_FILES, id });
      $(".row", element).append(...buttons);
      return element;
    };
    $("#performance").append(
      h("p", { class: "note" }, t("performance_hint")),
      this.performance,
      zone("performance-file", "drop_performance", takeOne, button("performance-pick", "pick_one", pickOne)),
    );
    $("#references").append(
      h("p", { class: "note" }, t("references_hint")),
      this.references,
      zone("reference-file", "drop_references", async (entries) => this.add(await upload(entries)), button("reference-pick", "pick_references", pickMany), this.suggestButton),
      this.suggestion,
    );
    this.buildOptions();
  }

  buildOptions() {
    this.mirrored = h("input", { type: "checkbox", id: "mirrored", onchange: () => this.change({ side: this.mirrored.checked ? "mirrored" : "same" }) });
    // Each repetition is graded at its own tempo, unless somebody wants it otherwise.
    this.repetitions = h("input", { type: "checkbox", id: "repetitions", onchange: () => this.change({ repetitions: this.repetitions.checked, tempo: this.repetitions.checked ? "free" : "same" }) });
    const tempo = (value) => {
      const input = h("input", { type: "radio", name: "tempo", value, id: `tempo-${value}`, onchange: () => this.change({ tempo: value }) });
      return h("label", { class: "check" }, input, t(`tempo_${value}`));
    };
    this.button = h("button", { type: "submit", class: "primary large", id: "grade" }, t("grade"));
    this.needs = h("p", { class: "note" }, t("needs"));
    $("#options").append(
      h("div", { class: "options" }, h("label", { class: "check" }, this.mirrored, t("mirrored")), h("label", { class: "check" }, this.repetitions, t("repetitions")), h("fieldset", { class: "row tempo" }, h("legend", {}, t("tempo")), h("div", { class: "row" }, tempo("same"), tempo("free")))),
      h("div", { class: "row go" }, this.button, this.needs),
    );
  }

  draw() {
    const { performance, references, side, tempo, repetitions } = this.choice;
    this.performance.replaceChildren(
      ...(performance ? [motionRow(performance, { onChange: (ref) => this.change({ performance: ref }), onRemove: () => this.change({ performance: null }) })] : []),
    );
    $("#performance .drop").classList.toggle("slim", Boolean(performance));
    $("#references .drop").classList.toggle("slim", references.length > 0);
    this.references.replaceChildren(...references.map((ref, place) => this.referenceRow(ref, place)));
    this.mirrored.checked = side === "mirrored";
    this.repetitions.checked = repetitions;
    $(`#tempo-${tempo}`).checked = true;
    this.button.disabled = !this.isReady();
    this.needs.hidden = this.isReady();
    this.suggestButton.disabled = !performance;
  }

  referenceRow(ref, place) {
    const others = () => this.choice.references.filter((_, other) => other !== place);
    return motionRow(ref, {
      first: place === 0,
      onChange: (changed) => this.change({ references: this.choice.references.map((one, other) => (other === place ? changed : one)) }),
      onRemove: () => this.change({ references: others() }),
      onFirst: place === 0 ? null : () => this.change({ references: [ref, ...others()] }),
    });
  }

  /** All clips of what the library takes the performance for, other performers first. */
  async suggest() {
    const { performance } = this.choice;
    this.suggestion.textContent = t("loading");
    const found = await attempt(async () => {
      const { answers: [answer] } = await post("/classify", { motions: [plain(performance)] });
      const category = answer.category ?? answer.guess;
      if (answer.problem || !category) return { said: answer.problem ?? t("suggested_unknown") };
      const { items } = await get("/clips", { category, kind: "clip", limit: 500 });
      const own = items.find((clip) => clip.motion === performance.motion)?.performer ?? null;
      const others = items.filter((clip) => clip.motion !== performance.motion);
      others.sort((a, b) => Number(own !== null && a.performer === own) - Number(own !== null && b.performer === own));
      return { category, clips: others.slice(0, MOST), sure: answer.category !== null, perhaps: answer.perhaps };
    });
    this.suggestion.textContent = found?.said ?? "";
    if (!found?.clips) return;
    const words = { category: found.category, count: found.clips.length };
    const said = found.clips.length ? (found.sure ? "suggested" : found.perhaps ? "suggested_perhaps" : "suggested_unsure") : "suggested_none";
    this.suggestion.textContent = t(said, words);
    this.add(found.clips.map((clip) => whole(clip.motion)));
  }
}

export { describeMotion };
