// What the query is taken for, in words and bars; unknown is said, and doubtful.

import { h, percent, t } from "../core/dom.js";
import { listReasons, openLater } from "./hits.js";

const MOST_BARS = 5;

function headline(answer) {
  if (answer.category === null && answer.perhaps) {
    return [h("span", { class: "badge unsure" }, "? ", t("doubtful")), h("h2", { class: "verdict-words" }, t("perhaps", { category: answer.guess })), h("p", { class: "note" }, t("verdict_perhaps"))];
  }
  if (answer.category === null) {
    return [h("span", { class: "badge unsure" }, "? ", t("unknown")), h("h2", { class: "verdict-words" }, t("verdict_unknown")), h("p", { class: "note" }, t("verdict_guess", { category: answer.guess }))];
  }
  const sure = answer.confidence ?? null;
  const words = sure === null ? t("verdict_known", { category: answer.category }) : t("verdict_sure", { category: answer.category, percent: percent(sure) });
  return [h("h2", { class: "verdict-words" }, words)];
}

const mirroredName = ({ category, guess, perhaps }) => category ?? (perhaps ? t("perhaps", { category: guess }) : guess);

function bars(histogram) {
  const shares = Object.entries(histogram).filter(([, share]) => share > 0);
  const rest = shares.slice(MOST_BARS);
  const row = (name, share) =>
    h("div", { class: "bar-row" }, h("span", { class: "name", title: name }, name), h("span", { class: "track", "aria-hidden": "true" }, h("i", { style: { width: `${100 * share}%` } })), h("span", { class: "value" }, `${percent(share)} %`));
  const others = rest.length ? [row(t("votes_rest", { count: rest.length }), rest.reduce((sum, [, share]) => sum + share, 0))] : [];
  return h("div", { class: "bars" }, ...shares.slice(0, MOST_BARS).map(([name, share]) => row(name, share)), ...others);
}

export function drawNoVerdict(element, sentence) {
  element.classList.remove("is-unknown", "is-doubtful");
  element.replaceChildren(h("p", { class: "problem-box" }, sentence));
}

export function drawAskPart(element, motion) {
  element.classList.remove("is-unknown", "is-doubtful");
  const link = h("a", { class: "button", href: `/takes?${new URLSearchParams({ motion })}` }, t("open_take"));
  element.replaceChildren(h("div", { class: "verdict-head", id: "ask-part" }, h("h2", { class: "verdict-words" }, t("ask_part")), h("p", {}, t("ask_part_how")), link));
}

/** explain() -> the answer with reasons; onGo(start, end) plays a moment. */
export function drawVerdict(element, answer, { explain, onGo }) {
  const why = openLater("why", async () => {
    const explained = await explain();
    return explained ? [listReasons(explained.explanation?.reasons, onGo)] : [];
  });
  const mirrored = answer.mirrored?.fits_better ? h("p", { class: "badge unsure" }, t("verdict_mirrored", { category: mirroredName(answer.mirrored) })) : null;
  const chance = answer.confidence == null || answer.category !== null ? null : h("p", { class: "note" }, t("verdict_right_share", { percent: percent(answer.confidence) }));
  element.classList.toggle("is-unknown", answer.category === null && !answer.perhaps);
  element.classList.toggle("is-doubtful", answer.category === null && Boolean(answer.perhaps));
  const words = h("div", { class: "verdict-head" }, ...headline(answer), mirrored, chance, why);
  element.replaceChildren(words, h("div", { class: "votes" }, h("h3", {}, t("votes")), bars(answer.histogram)));
}
