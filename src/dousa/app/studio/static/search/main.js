// The search page: choose a motion, see what it is and what is like it.

import { get, post, uploadAll } from "../core/api.js";
import { $, h, icon, t } from "../core/dom.js";
import { acceptDrops, dropZone } from "../core/drop.js";
import { attempt, notify } from "../core/notices.js";
import { pickClips } from "../core/pick.js";
import { Hits } from "./hits.js";
import { drawOptions } from "./options.js";
import { drawPlaces } from "./places.js";
import { Stage } from "./stage.js";
import { askOf, isSameMotion, isSameSearch, keepState, readState } from "./state.js";
import { drawVerdict } from "./verdict.js";

const ACCEPT = ".bvh,.amc,.asf,.c3d,.trc,.npz,.zip";
const NO_HIT = { hit: null, other_start_s: null, other_end_s: null };
const NO_PART = { start_s: null, end_s: null };

const clock = window.dousa.createClock();
const stage = new Stage(clock, { onPart: (part) => go({ ...part, ...NO_HIT }), onAlone: () => go(NO_HIT) });
const hits = new Hits($("#hits"), clock, {
  onChoose: (hit) => go({ ...NO_HIT, hit: hit.motion }),
  explain: () => explain(),
  onGo: (start, end) => stage.go(start, end),
});

let state = {};
let library = null;
let found = null; // the answer that is shown
let explained = null; // promise of the same with reasons
let places = [];
let asking = null;

// --- the state

function go(changes, { replace = false } = {}) {
  const next = { ...state, ...changes };
  keepState(next, { replace });
  apply(next);
}

function apply(next) {
  const [before, searched] = [state, Boolean(found)];
  state = next;
  $("#start").hidden = Boolean(state.motion);
  $("#search").hidden = $("#change").hidden = !state.motion;
  if (!state.motion) return;
  const again = !searched || !isSameSearch(before, state);
  if (again) search(!isSameMotion(before, state));
  drawOptions($("#options"), state, (changes) => go({ ...changes, ...NO_HIT }));
  attempt(() => stage.show(state, hitOf(state)));
  drawMatch();
}

/** What the search said of the match that is shown. */
function hitOf({ hit, other_start_s }) {
  if (!hit) return null;
  if (other_start_s !== null) return places.find((place) => place.motion === hit && Math.abs(place.start_s - other_start_s) < 0.01) ?? null;
  return found?.results.find((one) => one.motion === hit) ?? null;
}

function drawMatch() {
  stage.describeMatch(state, hitOf(state), { searchWith: (part) => go({ ...state, unit: null, up: null, ...NO_HIT, ...part }) });
  hits.mark(state.other_start_s === null ? state.hit : null);
}

// --- searching

async function search(fresh) {
  asking?.abort();
  const mine = (asking = new AbortController());
  const began = performance.now();
  explained = null;
  if (fresh) {
    hits.clear();
    $("#verdict").replaceChildren();
  }
  $("#places").hidden = true;
  $("#results-note").textContent = t("searching");
  const answer = await attempt(() => post("/search", askOf(state), mine.signal));
  if (mine !== asking) return;
  if (!answer) {
    $("#results-note").textContent = "";
    return;
  }
  found = answer;
  const others = answer.results.filter((hit) => !isQuery(hit));
  hits.draw(others.map((hit, place) => ({ ...hit, rank: place + 1 })));
  drawVerdict($("#verdict"), answer, { explain, onGo: (start, end) => stage.go(start, end) });
  const count = hits.cards.size;
  $("#results-note").textContent = count ? t("hits_found", { count, ms: Math.round(performance.now() - began) }) : t("hits_none");
  drawMatch();
  if (state.hit) attempt(() => stage.show(state, hitOf(state)));
  if (library.n_takes) searchTakes(mine);
}

/** A clip finds itself first; that says nothing. */
const isQuery = (hit) => hit.motion === state.motion && state.start_s === null && state.end_s === null;

async function searchTakes(mine) {
  const answer = await attempt(() => post("/search", { ...askOf(state), k: 1, inside_takes: true }, mine.signal));
  if (mine !== asking || !answer) return;
  places = answer.places.filter((place) => !isQueryPlace(place));
  drawPlaces($("#places"), places, (place) => go({ hit: place.motion, other_start_s: place.start_s, other_end_s: place.end_s }));
  drawMatch();
}

/** A part of a take finds itself too. */
const isQueryPlace = (place) => place.motion === state.motion && Math.min(place.end_s, state.end_s ?? Infinity) - Math.max(place.start_s, state.start_s ?? 0) > 0.5 * (place.end_s - place.start_s);

/** The answer with reasons: asked for when somebody wants to know. */
function explain() {
  explained ??= attempt(() => post("/search", { ...askOf(state), explain: true }));
  return explained;
}

// --- choosing what is searched for

async function take(entries) {
  const came = await attempt(() => uploadAll(entries));
  if (!came) return;
  for (const { name, reason } of came.refused) notify(`${name}: ${reason}`, "problem");
  const motion = came.files.find((file) => file.motion)?.motion;
  if (motion) go({ ...state, motion, ...NO_PART, ...NO_HIT, unit: null, up: null });
}

async function pick() {
  const [clip] = await pickClips({ kind: "clip" });
  if (clip) go({ ...state, motion: clip.motion ?? `clip:${clip.id}`, ...NO_PART, ...NO_HIT, unit: null, up: null });
}

function drawChoosing() {
  const pickButton = (kind, id) => h("button", { type: "button", class: kind, id, onclick: pick }, t(id === "pick" ? "start_pick" : "change_pick"));
  const zone = dropZone(take, { text: t("start_drop"), hint: t("start_hint"), accept: ACCEPT, id: "query-file" });
  $("#start").replaceChildren(h("div", { class: "choose" }, zone, h("p", { class: "or" }, t("or")), pickButton("", "pick")));
  const input = h("input", { type: "file", class: "sr", tabindex: "-1", "aria-hidden": "true", accept: ACCEPT, multiple: true, id: "change-file" });
  input.addEventListener("change", () => take([...input.files].map((file) => ({ file, path: file.name }))).then(() => (input.value = "")));
  $("#change").replaceChildren(input, h("button", { type: "button", onclick: () => input.click() }, icon("upload"), t("change_file")), pickButton("", "change-pick"));
  acceptDrops($("#main"), take);
}

function drawUntrained() {
  $("#start").hidden = false;
  $("#start").replaceChildren(h("div", { class: "card empty" }, h("p", {}, t("not_trained")), h("a", { class: "button primary", href: "/library" }, t("to_library"))));
}

async function start() {
  library = (await get("/info")).library;
  if (!library.trained_at) {
    drawUntrained();
    return;
  }
  drawChoosing();
  window.addEventListener("popstate", () => apply(readState()));
  apply(readState());
}

attempt(start);
