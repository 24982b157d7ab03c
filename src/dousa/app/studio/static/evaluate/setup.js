// The three steps before a grade: performance, takes of the reference, options.

import { drawFigure, get, post } from "../core/api.js";
import { $, formatSeconds, h, icon, t } from "../core/dom.js";
import { dropZone, MOTION_FILES, takeMotions } from "../core/drop.js";
import { attempt, notify } from "../core/notices.js";
import { pickClips } from "../core/pick.js";

// What is held against what, as it stands in the address; shapes that the modules of this page share.
//
// A motion here is {motion, start_s, end_s, unit, up} as the interface wants it, null where nothing is said.
const ASIDE = ["start_s", "end_s", "unit", "up", "joint_map"];

const toNumber = (text) => (text === null || text === "" || !Number.isFinite(Number(text)) ? null : Number(text));

/** A name in the address stands for a whole motion; commas occur in names of files. */
const splitNames = (text) => (text ? text.split(/,(?=(?:clip|file|job):)/) : []).filter(Boolean);

export const whole = (motion) => ({ motion });

export function plain(ref) {
  const asked = { motion: ref.motion };
  for (const name of ASIDE) if (ref[name] !== null && ref[name] !== undefined) asked[name] = ref[name];
  return asked;
}

export function readAddress() {
  const asked = new URLSearchParams(location.search);
  const motion = asked.get("performance");
  return {
    job: asked.get("job"),
    compare: asked.has("compare") ? asked.get("compare").split(",").filter(Boolean) : null,
    performance: motion ? { motion, start_s: toNumber(asked.get("start_s")), end_s: toNumber(asked.get("end_s")) } : null,
    references: splitNames(asked.get("references")).map(whole),
    side: asked.get("mirror") === "1" ? "mirrored" : "auto",
    tempo: asked.get("tempo") === "free" ? "free" : "same",
    repetitions: asked.get("repetitions") === "1",
  };
}

export function keepChoice({ performance, references, side, tempo, repetitions }) {
  const asked = new URLSearchParams();
  if (performance) {
    asked.set("performance", performance.motion);
    for (const name of ["start_s", "end_s"]) if (performance[name] != null) asked.set(name, String(performance[name]));
  }
  if (references.length) asked.set("references", references.map((ref) => ref.motion).join(","));
  if (side === "mirrored") asked.set("mirror", "1");
  if (tempo === "free") asked.set("tempo", "free");
  if (repetitions) asked.set("repetitions", "1");
  history.replaceState(null, "", `/evaluate${asked.size ? `?${asked}` : ""}`);
}

export const showJob = (id) => history.pushState(null, "", `/evaluate?job=${id}`);

// A chosen motion as a row: a small moving figure, its name and length, a part of it, buttons.
const known = new Map(); // motion -> promise of what it is

function describeMotion(ref) {
  const asked = plain({ ...ref, start_s: null, end_s: null });
  const key = JSON.stringify(asked);
  if (!known.has(key)) known.set(key, get("/motions/info", asked));
  return known.get(key);
}

function partFields(ref, duration, onChange) {
  const field = (name, word) => {
    const input = h("input", { type: "number", min: "0", max: duration.toFixed(2), step: "0.1", value: ref[name] ?? "", "aria-label": t(word), placeholder: t(word) });
    input.addEventListener("change", () => {
      const value = input.value === "" ? null : Number(input.value);
      onChange({ ...ref, [name]: Number.isFinite(value) ? value : null });
    });
    return input;
  };
  const open = ref.start_s != null || ref.end_s != null;
  return h("details", { class: "part", open }, h("summary", {}, t("part")), h("div", { class: "row" }, field("start_s", "part_from"), "–", field("end_s", "part_to")));
}

/** options: {first: bool, onChange(ref), onRemove(), onFirst()} -> row; onBroken() when the motion cannot be used */
function motionRow(ref, { first = false, onChange, onRemove, onFirst = null, onBroken = () => {} }) {
  const canvas = h("canvas", { class: "figure-small", "aria-hidden": "true" });
  const name = h("b", { class: "motion-name" }, ref.motion.split("/").pop());
  const facts = h("span", { class: "note" }, t("loading"));
  const remove = h("button", { type: "button", class: "quiet small icon", onclick: onRemove }, icon("close"));
  const front = onFirst ? h("button", { type: "button", class: "quiet small", onclick: onFirst }, t("make_first")) : null;
  const text = h("div", { class: "motion-text" }, h("div", { class: "row" }, name, first ? h("span", { class: "badge" }, t("first")) : null), facts);
  const row = h("li", { class: "motion", dataset: { motion: ref.motion } }, canvas, text, front, remove);
  remove.setAttribute("aria-label", t("take_away", { name: name.textContent }));
  describeMotion(ref).then(
    (info) => {
      name.textContent = name.title = info.name || t("unnamed");
      remove.setAttribute("aria-label", t("take_away", { name: info.name }));
      facts.textContent = [info.category, formatSeconds(info.duration_s)].filter(Boolean).join(" · ");
      text.append(partFields(ref, info.duration_s, onChange));
      drawFigure(canvas, plain(ref), { host: row });
    },
    (error) => {
      facts.textContent = error.message;
      facts.classList.add("bad");
      notify(error.message, "problem");
      onBroken();
    },
  );
  return row;
}

const MOST = 50;

const isSame = (a, b) => JSON.stringify(plain(a)) === JSON.stringify(plain(b));

const upload = async (entries) => (await takeMotions(entries)).map(whole);

export class Setup {
  constructor(onGrade) {
    this.form = $("#setup");
    this.choice = { performance: null, references: [], side: "auto", tempo: "same", repetitions: false };
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
    this.count = h("p", { class: "note", id: "performance-count", role: "status" });
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
      this.count,
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
    this.mirrored = h("input", { type: "checkbox", id: "mirrored", onchange: () => this.change({ side: this.mirrored.checked ? "mirrored" : "auto" }) });
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
    this.sayCount(repetitions && performance ? plain(performance) : null);
  }

  /** How often an exercise is repeated needs no reference: it stands below the performance. */
  async sayCount(asked) {
    const key = asked && JSON.stringify(asked);
    if (key === this.counted) return;
    this.counted = key;
    this.count.textContent = asked ? t("loading") : "";
    const found = asked && (await attempt(() => get("/motions/count", asked)));
    if (key !== this.counted) return;
    const times = (found?.repetitions ?? []).map((one) => `${formatSeconds(one.start_s)}–${formatSeconds(one.end_s)}`).join(", ");
    this.count.textContent = found ? t(found.count ? "counted" : "counted_none", { count: found.count, certainty: Math.round(100 * found.certainty), times }) : "";
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

