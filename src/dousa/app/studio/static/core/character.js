// The user's character: a file over whose skeleton motions are put. It is uploaded once, and remembered by the browser
// and in the folder of the studio until another one is chosen.

import { get } from "./api.js";
import { h, icon, t } from "./dom.js";
import { dropZone } from "./drop.js";
import { takeMotions } from "./incoming.js";
import { attempt } from "./notices.js";

const KEY = "dousa-character";
const FILES = ".bvh,.glb,.gltf,.vrm,.fbx,.amc,.asf,.npz,.mvnx,.zip";

function recall() {
  try {
    return JSON.parse(localStorage.getItem(KEY));
  } catch {
    return null; // nothing of ours, or nothing may be kept
  }
}

function keep(character) {
  try {
    if (character) localStorage.setItem(KEY, JSON.stringify(character));
    else localStorage.removeItem(KEY);
  } catch {
    // it lasts as long as the page
  }
}

/** A field to choose the character in. onChange(character or null), {motion, name, suffix, height_m} -> element */
export function characterField(onChange) {
  const element = h("div", { class: "character" });
  const choose = (character) => {
    keep(character);
    draw(character);
    onChange(character);
  };
  const take = async (entries) => {
    const [motion] = await takeMotions(entries);
    if (!motion) return;
    const character = await attempt(() => get("/export/character", { motion }));
    if (character) choose(character);
  };
  const draw = (character) => {
    if (!character) {
      element.replaceChildren(h("p", { class: "field-name" }, t("character")), dropZone(take, { text: t("character_drop"), hint: t("character_hint"), accept: FILES, id: "character-file" }));
      return;
    }
    const other = h("button", { type: "button", class: "quiet small", id: "character-none", onclick: () => choose(null) }, icon("close"), t("character_none"));
    const facts = t("character_facts", { joints: character.n_joints, metres: character.height_m.toFixed(2) });
    const doubts = character.notes.map((note) => h("p", { class: "note" }, note));
    element.replaceChildren(h("p", { class: "field-name" }, t("character")), h("div", { class: "row" }, h("b", { class: "character-name" }, character.name), h("span", { class: "note" }, facts), other), ...doubts);
    if (document.activeElement === document.body) other.focus(); // the button that was pressed is gone
  };
  draw(null);
  // What was remembered may be gone from the studio by now.
  const before = recall();
  if (before) get("/export/character", { motion: before.motion }).then(choose, () => choose(null));
  return element;
}
