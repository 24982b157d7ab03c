// The search page: choose a motion, see what it is and what is like it.

import { get, post } from "../core/api.js";
import { $, h, icon, t } from "../core/dom.js";
import { dropZone, MOTION_FILES, offerChange, showUntrained, takeMotions } from "../core/drop.js";
import { attempt, notify, showProblem } from "../core/notices.js";
import { pickClips } from "../core/pick.js";
import { spellingButton } from "../core/spelling.js";
import { drawPlaces, exportHits, Hits } from "./hits.js";
import { Stage } from "./stage.js";
import { askOf, drawOptions, isSameMotion, isSameSearch, keepState, readState, wholeOf } from "./state.js";
import { drawAskPart, drawNoVerdict, drawVerdict } from "./verdict.js";
import { Words } from "./words.js";

const TITLE = document.title;
const LOOK_AGAIN = 1000; // ms between looks what a search waits for
const NO_HIT = { hit: null, other_start_s: null, other_end_s: null };
const NO_PART = { start_s: null, end_s: null };

const clock = window.dousa.createClock();
const stage = new Stage(clock, { onPart: (part) => go({ ...part, ...NO_HIT }), onAlone: () => go(NO_HIT) });
const hits = new Hits($("#hits"), clock, {
  onChoose: (hit) => compare({ ...NO_HIT, hit: hit.motion }),
  explain: () => explain(),
  onGo: (start, end) => stage.go(start, end),
});

const words = new Words($("#ask-words"), $("#words-found"), {
  onAsk: (text) => go({ ...state, text, from: null }),
  onChoose: (hit, part) => playHit({ motion: hit.motion, ...(part ?? NO_PART), ...NO_HIT, unit: null, up: null }),
});

let state = {};
let library = null;
let known = null; // {state, info} of the motion that is shown
let sought = null; // the state that was searched for last
let found = null; // the answer that is shown
let explained = null; // promise of the same with reasons
let places = [];
let asking = null;

function go(changes, { replace = false } = {}) {
  const next = { ...state, ...changes };
  keepState(next, { replace });
  apply(next);
}

function compare(changes) {
  go(changes);
  stage.reveal();
}

function playHit(changes) {
  go({ ...changes, text: null, from: state.text });
  $("#back-to-words")?.focus();
}

async function apply(next) {
  state = next;
  words.show(state.text);
  drawWayBack();
  showFrame(Boolean(state.motion));
  if (!state.motion) {
    leave();
    return;
  }
  drawOptions($("#options"), state, (changes) => go({ ...changes, ...NO_HIT }));
  if (!known || !isSameMotion(known.state, state)) {
    const mine = state;
    clearAnswer();
    $("#results-note").textContent = t("loading");
    try {
      const info = await get("/motions/info", wholeOf(state));
      if (state !== mine) return;
      known = { state, info };
    } catch (error) {
      if (state === mine) giveUp(error);
      return;
    }
  }
  if (isWholeTake()) askForPart();
  else if (!sought || !isSameSearch(sought, state)) search();
  showStage();
  drawMatch();
}

function drawWayBack() {
  const back = () => go({ ...state, motion: null, ...NO_PART, ...NO_HIT, text: state.from, from: null });
  $("#from-words").hidden = !state.from || Boolean(state.text);
  $("#from-words").replaceChildren(...($("#from-words").hidden ? [] : [h("button", { type: "button", class: "small", id: "back-to-words", onclick: back }, icon("undo"), t("words_back", { text: state.from }))]));
}

function showFrame(shown, problem = "") {
  $("#start").hidden = shown;
  $("#search").hidden = $("#change").hidden = !shown;
  showProblem(problem);
}

function leave() {
  asking?.abort();
  asking = known = sought = null;
  stage.leave();
  document.title = TITLE;
}

function giveUp(error) {
  state = { ...state, motion: null, unit: null, up: null, ...NO_PART, ...NO_HIT };
  leave();
  showFrame(false, error.message);
}

async function showStage() {
  const mine = state;
  try {
    await stage.show(state, hitOf(state), known.info);
  } catch (error) {
    if (state !== mine) return;
    if (!state.hit) {
      giveUp(error);
      return;
    }
    notify(error.message, "problem"); // the match is gone, the query is not
    go(NO_HIT, { replace: true });
  }
}

function hitOf({ hit, other_start_s }) {
  if (!hit) return null;
  if (other_start_s !== null) return places.find((place) => place.motion === hit && Math.abs(place.start_s - other_start_s) < 0.01) ?? null;
  return found?.results.find((one) => one.motion === hit) ?? null;
}

function drawMatch() {
  stage.describeMatch(state, hitOf(state), { searchWith: (part) => go({ ...state, unit: null, up: null, ...NO_HIT, ...part, from: null }) });
  hits.mark(state.other_start_s === null ? state.hit : null);
}

function clearAnswer() {
  asking?.abort();
  asking = sought = found = explained = null;
  places = [];
  hits.clear();
  $("#export-hits").hidden = true;
  $("#verdict").replaceChildren();
  $("#places").hidden = true;
  $("#results-note").textContent = "";
}

/** A part that is all of it counts as whole: so it begins when one end is set by key. */
function isWholeTake() {
  const { kind, duration_s } = known.info;
  return kind === "take" && (state.end_s ?? duration_s) - (state.start_s ?? 0) > duration_s - 0.05;
}

function askForPart() {
  clearAnswer();
  drawAskPart($("#verdict"), state.motion);
}

async function search() {
  asking?.abort();
  const mine = (asking = new AbortController());
  const began = performance.now();
  sought = state;
  explained = null;
  $("#places").hidden = true;
  $("#results-note").textContent = t("searching");
  const quiet = tellLearning(mine);
  let answer;
  try {
    answer = await post("/search", askOf(state), mine.signal).finally(quiet);
  } catch (error) {
    if (mine !== asking || error.name === "AbortError") return;
    clearAnswer();
    drawNoVerdict($("#verdict"), error.message);
    return;
  }
  if (mine !== asking) return;
  found = answer;
  const others = answer.results.filter((hit) => !isQuery(hit));
  hits.draw(others.map((hit, place) => ({ ...hit, rank: place + 1 })));
  drawVerdict($("#verdict"), answer, { explain, onGo: (start, end) => stage.go(start, end) });
  const count = hits.cards.size;
  $("#export-hits").hidden = count === 0;
  const alike = answer.alike_count == null ? "" : `${t("alike_count", { count: answer.alike_count - answer.results.filter((hit) => isQuery(hit) && hit.alike).length })} · `;
  $("#results-note").textContent = count ? alike + t("hits_found", { count, ms: Math.round(performance.now() - began) }) : t("hits_none");
  drawMatch();
  if (state.hit) showStage();
  if (library.n_takes) searchTakes(mine);
}

/** The first search with a body that lacks joints learns them first: for a minute there is more to say than "searching". */
function tellLearning(mine) {
  const timer = setInterval(async () => {
    const { learning } = await get("/search/learning").catch(() => ({}));
    if (mine !== asking || ended || !learning) return;
    const bar = h("progress", { max: String(Math.max(learning.total, 1)), value: learning.done > 0 ? String(learning.done) : null, "aria-label": t("searching") });
    $("#results-note").replaceChildren(`${learning.what} `, bar);
  }, LOOK_AGAIN);
  let ended = false;
  return () => {
    ended = true;
    clearInterval(timer);
  };
}

const isQuery = (hit) => hit.motion === state.motion && state.start_s === null && state.end_s === null;

async function searchTakes(mine) {
  const answer = await attempt(() => post("/search", { ...askOf(state), k: 1, inside_takes: true }, mine.signal));
  if (mine !== asking || !answer) return;
  places = answer.places.filter((place) => !isQueryPlace(place));
  drawPlaces($("#places"), places, (place) => compare({ hit: place.motion, other_start_s: place.start_s, other_end_s: place.end_s }));
  drawMatch();
}

const isQueryPlace = (place) => place.motion === state.motion && Math.min(place.end_s, state.end_s ?? Infinity) - Math.max(place.start_s, state.start_s ?? 0) > 0.5 * (place.end_s - place.start_s);

/** The answer with reasons: asked for when somebody wants to know. */
function explain() {
  explained ??= attempt(() => post("/search", { ...askOf(state), explain: true }));
  return explained;
}

async function take(entries) {
  const [motion] = await takeMotions(entries);
  if (motion) go({ ...state, motion, ...NO_PART, ...NO_HIT, unit: null, up: null, from: null });
}

async function pick() {
  const [clip] = await pickClips({ kind: "clip" });
  if (clip) go({ ...state, motion: clip.motion ?? `clip:${clip.id}`, ...NO_PART, ...NO_HIT, unit: null, up: null, from: null });
}

function drawChoosing() {
  const zone = dropZone(take, { text: t("start_drop"), hint: t("start_hint"), accept: MOTION_FILES, id: "query-file" });
  $("#start").replaceChildren(h("div", { class: "choose" }, zone, h("p", { class: "or" }, t("or")), h("button", { type: "button", id: "pick", onclick: pick }, t("start_pick"))));
  offerChange(take, pick);
}

async function start() {
  library = (await get("/info")).library;
  if (!library.trained_at) {
    words.show(readState().text);
    showUntrained();
    return;
  }
  drawChoosing();
  $("#export-hits").addEventListener("click", () => exportHits(found.results.filter((hit) => !isQuery(hit))));
  $("#spelling").replaceChildren(spellingButton(() => post("/spelling/search", askOf(state))));
  window.addEventListener("popstate", () => apply(readState()));
  apply(readState());
}

attempt(start);
