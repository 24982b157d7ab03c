// Who was found: one line a person with its colour, the tracks of each view, and what somebody changes about them.

import { h, icon, t } from "../core/dom.js";

const COLOURS = ["#e8590c", "#0b7fc4", "#0a8f6a", "#b0489a", "#a17400", "#4a6fe3"]; // of Okabe and Ito, by and large
const NOBODY = "#7a828e";

export const colourOf = (person) => (person === null ? NOBODY : COLOURS[person % COLOURS.length]);
const keyOf = (view, track) => `${view}:${track}`;
const keysOf = (tracks) => new Set(tracks.map(([view, track]) => keyOf(view, track)));
const readKey = (key) => key.split(":").map(Number);
const percent = (share) => `${Math.round(100 * share)} %`;

export class Choice {
  constructor() {
    Object.assign(this, { film: null, person: null, leftOut: new Set(), added: new Set(), owner: new Map() });
  }

  update(film) {
    const first = this.film === null;
    const had = this.wants();
    this.film = film;
    this.owner = new Map(film.people.flatMap((person, index) => person.members.map(([view, track]) => [keyOf(view, track), index])));
    if (first) this.leftOut = keysOf(film.left_out);
    if (first || !had) this.person = film.chosen;
    if (!had) this.added.clear();
  }

  wants() {
    if (!this.film) return false;
    const before = keysOf(this.film.left_out);
    const same = before.size === this.leftOut.size && [...before].every((key) => this.leftOut.has(key));
    return !same || this.added.size > 0 || this.person !== this.film.chosen;
  }

  personOf(view, track) {
    return this.added.has(keyOf(view, track)) ? this.person : (this.owner.get(keyOf(view, track)) ?? null);
  }

  pick(person) {
    this.person = person;
    this.added.clear();
  }

  /** Whether a track could be the chosen person too, whom this view does not show yet. */
  couldBe(view, track) {
    if (this.person === null || this.personOf(view, track) === this.person || this.leftOut.has(keyOf(view, track))) return false;
    return !this.film.views[view].people.some((_, other) => this.personOf(view, other) === this.person && !this.leftOut.has(keyOf(view, other)));
  }

  add(view, track) {
    this.added.add(keyOf(view, track));
  }

  toggle(view, track) {
    const key = keyOf(view, track);
    if (!this.leftOut.delete(key)) this.leftOut.add(key);
    this.added.delete(key);
  }

  reset() {
    this.leftOut = keysOf(this.film.left_out);
    this.pick(this.film.chosen);
  }

  request() {
    const members = this.person === null ? [] : [...this.film.people[this.person].members, ...[...this.added].map(readKey)];
    const person = members.filter(([view, track]) => !this.leftOut.has(keyOf(view, track)));
    return { person: person.length ? person : null, left_out: [...this.leftOut].map(readKey) };
  }
}

/** choice: a Choice; active: whether the job is under way; on: {pick(person), toggle(view, track), same(view, track), fit(), undo()} */
export function showPeople(place, choice, active, on) {
  const { film } = choice;
  const focused = place.contains(document.activeElement) ? document.activeElement.dataset.key : null;
  place.replaceChildren(...film.people.map((person, index) => personRow(choice, person, index, on)), rest(choice, on), changes(choice, active, on));
  if (focused) [...place.querySelectorAll("[data-key]")].find((element) => element.dataset.key === focused)?.focus();
}

function personRow(choice, person, index, on) {
  const { film } = choice;
  const chosen = choice.person === index;
  const views = person.seen.filter((share) => share > 0).length;
  const name = t("person_name", { number: index + 1 });
  return h(
    "div",
    { class: `person${chosen ? " chosen" : ""}`, dataset: { person: String(index) } },
    h(
      "button",
      { type: "button", class: "person-pick quiet", "aria-pressed": String(chosen), dataset: { key: `person-${index}` }, onclick: () => on.pick(index) },
      h("i", { class: "person-dot", style: { background: colourOf(index) }, "aria-hidden": "true" }),
      h("span", { class: "person-name" }, name, chosen ? h("b", {}, icon("mark"), t("person_chosen")) : null),
      h("span", { class: "note" }, t("person_seen", { views, total: film.views.length, share: percent(Math.max(...person.seen)) })),
    ),
    h("ul", { class: "tracks" }, ...person.members.map(([view, track]) => trackItem(choice, view, track, name, on))),
  );
}

function trackItem(choice, view, track, who, on) {
  const out = choice.leftOut.has(keyOf(view, track));
  const { name } = choice.film.views[view];
  const added = choice.added.has(keyOf(view, track));
  const button = (key, label, act) => h("button", { type: "button", class: "small quiet", "aria-label": t("track_of", { action: label, who, view: name }), dataset: { key: `${key}-${view}-${track}` }, onclick: () => act(view, track) }, label);
  return h(
    "li",
    { class: out ? "out" : "" },
    h("span", {}, added ? `${name} → ${choice.person + 1}` : name),
    button("track", t(out ? "track_back" : "track_out"), on.toggle),
    choice.couldBe(view, track) ? button("same", t("menu_same", { number: choice.person + 1 }), on.same) : null,
  );
}

/** Tracks of nobody: all of them while no people were found, then those that belong to none. */
function rest(choice, on) {
  const found = choice.film.people.length > 0;
  const all = choice.film.views.flatMap((view, index) => view.people.map((_, track) => [index, track]));
  const tracks = found ? all.filter(([view, track]) => choice.personOf(view, track) === null) : all;
  if (!tracks.length) return found ? "" : h("p", { class: "note" }, t("people_waiting"));
  const items = tracks.map(([view, track]) => trackItem(choice, view, track, t("track_name", { number: track + 1 }), on));
  const dot = found ? h("i", { class: "person-dot", style: { background: NOBODY }, "aria-hidden": "true" }) : null;
  return h("div", { class: "person" }, h("p", { class: "note" }, dot, t(found ? "people_rest" : "people_unmatched")), h("ul", { class: "tracks" }, ...items));
}

function changes(choice, active, on) {
  const anybody = choice.film.views.some((view) => view.people.length);
  if (!choice.wants()) return anybody ? h("p", { class: "note" }, t("people_hint")) : "";
  const again = h("button", { type: "button", class: "primary", id: "fit-again", disabled: active, dataset: { key: "again" }, onclick: on.fit }, t("fit_again"));
  const undo = h("button", { type: "button", class: "quiet", dataset: { key: "undo" }, onclick: on.undo }, t("fit_undo"));
  return h("div", { class: "changes", role: "status" }, h("p", {}, t(active ? "changes_wait" : "changes")), h("div", { class: "row" }, again, undo));
}
