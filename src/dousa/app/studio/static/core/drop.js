// Dropping and choosing files and folders.

import { uploadAll } from "./api.js";
import { pairTable } from "./dialog.js";
import { $, count, h, icon, t } from "./dom.js";
import { attempt, notify } from "./notices.js";

// Files that are looked at without being added to the library.

/** Upload entries [{file, path}]; -> the names of the motions among them. What cannot be used is told. */
export async function takeMotions(entries) {
  const came = await attempt(() => uploadAll(entries));
  if (!came) return [];
  for (const { name, reason } of came.refused) notify(`${name}: ${reason}`, "problem");
  const motions = came.files.filter((file) => file.motion).map((file) => file.motion);
  if (!motions.length && !came.refused.length) notify(t("no_motion_file"), "problem");
  return motions;
}

/** What a file dialogue offers where labels or a motion are wanted; the studio looks at what comes. */
export const LABEL_FILES = ".eaf,.TextGrid,.csv,.tsv";
export const MOTION_FILES = ".bvh,.amc,.asf,.c3d,.trc,.npz,.npy,.pkl,.pk,.pickle,.joblib,.pt,.csv,.tsv,.json,.vmd,.mot,.mvnx,.fbx,.dae,.usd,.usda,.usdc,.usdz,.glb,.gltf,.vrm,.vrma,.zip";

async function readEntry(entry, prefix, found) {
  if (entry.isFile) {
    const file = await new Promise((resolve, reject) => entry.file(resolve, reject));
    if (!file.name.startsWith(".")) found.push({ file, path: prefix + file.name });
    return;
  }
  const reader = entry.createReader();
  for (;;) {
    // A reader gives a hundred entries at a time.
    const some = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
    if (!some.length) return;
    for (const inner of some) await readEntry(inner, `${prefix}${entry.name}/`, found);
  }
}

async function entriesOf(transfer) {
  const items = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  const found = [];
  const sign = showReading(found);
  try {
    if (items.length) for (const item of items) await readEntry(item, "", found);
    else for (const file of transfer.files) found.push({ file, path: file.name });
  } finally {
    sign.end();
  }
  return found;
}

const SIGN_AFTER = 150; // ms; a folder of thousands is read for seconds

/** Says that a folder is being read, and how many files there are already. */
function showReading(found) {
  const text = h("p", { class: "reading-folder", role: "status" });
  const timer = setInterval(() => {
    text.textContent = t("reading_drop", { count: count.format(found.length) });
    if (!text.isConnected) document.body.append(text);
  }, SIGN_AFTER);
  return {
    end() {
      clearInterval(timer);
      text.remove();
    },
  };
}

/** Let files be dropped on an element; onEntries([{file, path}]). */
export function acceptDrops(element, onEntries) {
  let depth = 0;
  const set = (value) => {
    depth = Math.max(value, 0);
    element.classList.toggle("over", depth > 0);
  };
  element.addEventListener("dragenter", (event) => {
    if (![...event.dataTransfer.types].includes("Files")) return;
    event.preventDefault();
    set(depth + 1);
  });
  element.addEventListener("dragleave", () => set(depth - 1));
  element.addEventListener("dragover", (event) => {
    if ([...event.dataTransfer.types].includes("Files")) event.preventDefault();
  });
  element.addEventListener("drop", async (event) => {
    event.preventDefault();
    event.stopPropagation();
    set(0);
    const entries = await entriesOf(event.dataTransfer);
    if (entries.length) onEntries(entries);
  });
  // A drop on a zone inside this one does not come up to it, but it ends the dragging.
  window.addEventListener("drop", () => set(0), true);
}

/** An input that is not seen, for a button to open; onEntries([{file, path}]). */
export function fileInput(onEntries, options) {
  const input = h("input", { type: "file", class: "sr", tabindex: "-1", "aria-hidden": "true", ...options });
  input.addEventListener("change", () => {
    const entries = [...input.files].map((file) => ({ file, path: file.webkitRelativePath || file.name }));
    input.value = "";
    if (entries.length) onEntries(entries);
  });
  return input;
}

/** A zone with words and buttons. options: {text, hint, accept, multiple, folders, id} -> element */
export function dropZone(onEntries, { text = t("drop_here"), hint, accept, multiple = true, folders = false, id } = {}) {
  const pick = (folder) => {
    const input = fileInput(onEntries, { accept, multiple, id: id && (folder ? `${id}-folder` : id) });
    if (folder) input.webkitdirectory = true;
    const button = h("button", { type: "button", onclick: () => input.click() }, icon(folder ? "folder" : "upload"), t(folder ? "choose_folder" : "choose_files"));
    return [input, button];
  };
  const zone = h(
    "div",
    { class: "drop" },
    h("p", {}, text),
    h("div", { class: "row" }, ...pick(false), ...(folders ? pick(true) : [])),
    hint ? h("p", { class: "note" }, hint) : null,
  );
  acceptDrops(zone, onEntries);
  return zone;
}

/** The list of files that were not taken, and why; null if there are none. */
export function refusedList(refused) {
  return pairTable("refused_title", refused.map(({ name, reason }) => [name, reason]), { kind: "refused", open: true });
}

/** Of a page that needs a library that has learned: where it learns. */
export function showUntrained() {
  $("#start").hidden = false;
  $("#start").replaceChildren(h("div", { class: "card empty" }, h("p", {}, t("not_trained")), h("a", { class: "button primary", href: "/library" }, t("to_library"))));
}

/** Buttons to look at something else: at other files, which may be dropped too, or at a motion of the library. */
export function offerChange(take, pick) {
  const input = fileInput(take, { accept: MOTION_FILES, multiple: true, id: "change-file" });
  $("#change").replaceChildren(input, h("button", { type: "button", onclick: () => input.click() }, icon("upload"), t("change_file")), h("button", { type: "button", id: "change-pick", onclick: pick }, t("change_pick")));
  acceptDrops($("#main"), take);
}

// A file that misses every zone would replace the page.
for (const name of ["dragover", "drop"]) window.addEventListener(name, (event) => event.preventDefault());
