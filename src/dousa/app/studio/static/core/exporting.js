// Taking clips along: format, character, the job, the ZIP file. One motion is downloaded at once.

import { get, post } from "./api.js";
import { foot, openDialog, pairTable } from "./dialog.js";
import { $, count, h, icon, keep, recall, t } from "./dom.js";
import { dropZone, takeMotions } from "./drop.js";
import { followJob, isActive, stopJob } from "./jobs.js";
import { attempt } from "./notices.js";
import { spellingButton } from "./spelling.js";

// The user's character: a file over whose skeleton motions are put. It is uploaded once, and remembered by the browser
// and in the folder of the studio until another one is chosen.
const KEY = "dousa-character";
const FILES = ".bvh,.glb,.gltf,.vrm,.fbx,.amc,.asf,.npz,.mvnx,.zip";

/** A field to choose the character in. onChange(character or null), {motion, name, suffix, height_m} -> element */
function characterField(onChange) {
  const element = h("div", { class: "character" });
  const choose = (character) => {
    keep("localStorage", KEY, character);
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
  const before = recall("localStorage", KEY);
  if (before) get("/export/character", { motion: before.motion }).then(choose, () => choose(null));
  return element;
}

const FIRST = ["glb", "bvh", "fbx"]; // what an animator asks for; the others follow
const many = (number) => t(number === 1 ? "export_one" : "export_many", { count: count.format(number) });
const addressOf = (job) => `/api/exports/${job.id}`;

/** Export clips [number] as a ZIP file; hits: [{id, name, note}] to choose among them. */
export function openExport(ids, hits = null) {
  const body = h("div", { class: "stack exporting" });
  let end = () => {};
  const { close } = openDialog(t("export_title"), body, { onClose: () => end() });
  ask(body, {
    spell: (wanted, clips) => post("/spelling/export", { ...wanted, clips }),
    about: hits ? tickList(hits) : { element: h("p", { class: "note" }, many(ids.length)), chosen: () => ids, onChange: () => {} },
    original: true,
    close,
    go: (wanted, clips) =>
      attempt(async () => {
        const { id } = await post("/jobs/export", { ...wanted, clips });
        end = followJob(id, (job) => show(body, job, close));
      }),
  });
}

export function openDownload(part, title = t("onto_title")) {
  const body = h("div", { class: "stack exporting" });
  const { close } = openDialog(title, body);
  ask(body, {
    about: { element: null, chosen: () => [part], onChange: () => {} },
    original: false,
    close,
    go: (wanted) => {
      const asked = Object.entries({ ...part, ...wanted }).filter(([, value]) => value !== null && value !== false);
      fetchFile(`/api/motions/file?${new URLSearchParams(asked)}`);
      close();
    },
  });
}

function tickList(hits) {
  const boxes = hits.map((hit) => h("input", { type: "checkbox", checked: true, value: String(hit.id) }));
  const note = h("p", { class: "note", role: "status" }, many(hits.length));
  const list = {
    chosen: () => boxes.filter((box) => box.checked).map((box) => Number(box.value)),
    onChange: () => {},
    element: h("fieldset", { class: "ticks" }, h("legend", {}, t("export_hits")), h("div", { class: "scroll" }, ...hits.map((hit, at) => h("label", { class: "check" }, boxes[at], h("span", { class: "name" }, hit.name), h("span", { class: "note" }, hit.note ?? "")))), note),
  };
  list.element.addEventListener("change", () => {
    note.textContent = many(list.chosen().length);
    list.onChange();
  });
  return list;
}

async function ask(body, { about, original, close, go, spell }) {
  const known = await attempt(() => get("/export/formats"));
  if (!known) {
    close();
    return;
  }
  const names = Object.keys(known.formats).sort((a, b) => (FIRST.indexOf(a) + 1 || 99) - (FIRST.indexOf(b) + 1 || 99));
  const format = h("select", { id: "export-format" }, ...names.map((name) => h("option", { value: name, disabled: name in known.missing }, known.missing[name] ?? name.toUpperCase())), original ? h("option", { value: known.original }, t("export_original")) : null);
  const reach = h("input", { type: "checkbox", id: "export-reach" });
  const reachLine = h("label", { class: "check", hidden: true }, reach, t("export_reach"));
  const send = h("button", { type: "submit", class: "primary", id: "export-go" }, icon("download"), t(original ? "export_go" : "download_file"));
  let character = null;
  let touched = false; // a format that somebody chose stays
  const update = () => {
    const asIs = format.value === known.original;
    field.hidden = asIs;
    reachLine.hidden = asIs || !character;
    send.disabled = about.chosen().length === 0;
  };
  const wanted = () => {
    const onto = format.value === known.original ? null : (character?.motion ?? null);
    return { to: format.value, onto, keep_reach: Boolean(onto) && reach.checked };
  };
  const field = characterField((chosen) => {
    character = chosen;
    const own = chosen?.suffix.slice(1);
    if (!touched && names.includes(own) && !(own in known.missing)) format.value = own;
    update();
  });
  about.onChange = update;
  format.addEventListener("change", () => {
    touched = true;
    update();
  });
  const form = h(
    "form",
    { class: "stack" },
    about.element,
    h("label", { class: "field narrow" }, t("export_format"), format),
    field,
    reachLine,
    foot(...(spell ? [spellingButton(() => spell(wanted(), about.chosen()), "")] : []), h("button", { type: "button", onclick: close }, t("cancel")), send),
  );
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    send.disabled = true;
    await go(wanted(), about.chosen());
    send.disabled = false;
  });
  body.replaceChildren(form);
  update();
  format.focus();
}

function show(body, job, close) {
  if (isActive(job)) {
    const bar = $("progress", body);
    if (!bar) {
      const stop = h("button", { type: "button", class: "danger", id: "export-stop", onclick: () => attempt(() => stopJob(job.id)) }, t("stop"));
      body.replaceChildren(h("p", { role: "status" }, t("exporting")), h("progress", { "aria-label": t("exporting") }), h("p", { class: "note what" }), h("p", { class: "note" }, t("export_goes_on")), foot(h("button", { type: "button", onclick: close }, t("close")), stop));
      $("button", body).focus();
      return;
    }
    if (job.total) {
      bar.max = job.total;
      bar.value = job.done;
    }
    $(".what", body).textContent = job.total ? `${job.what} (${count.format(job.done)}/${count.format(job.total)})` : (job.what ?? "");
    return;
  }
  const { result } = job;
  const link = result?.bytes ? h("a", { class: "button primary", id: "export-file", href: addressOf(job), download: "" }, icon("download"), t("export_file", { megabytes: Math.max(result.bytes / 1e6, 0.1).toFixed(1) })) : null;
  const said = result ? t("export_done", { count: count.format(result.n_files), skipped: count.format(result.skipped.length + result.n_gone) }) : (job.problem ?? t(`state_${job.state}`));
  const skipped = pairTable("export_skipped", (result?.skipped ?? []).map(({ path, reason }) => [path, reason]), { kind: "refused" });
  body.replaceChildren(...[h("p", { role: "status", class: job.problem ? "problem-box" : "" }, said), skipped, foot(h("button", { type: "button", onclick: close }, t("close")), ...(link ? [link] : []))].filter(Boolean));
  if (link) {
    link.focus();
    fetchFile(addressOf(job));
  }
}

function fetchFile(href) {
  const link = h("a", { href, download: "", class: "sr" });
  document.body.append(link);
  link.click();
  link.remove();
}
