// Dropping and choosing files and folders.

import { uploadAll } from "./api.js";
import { h, icon, language, t } from "./dom.js";
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
export const MOTION_FILES = ".bvh,.amc,.asf,.c3d,.trc,.npz,.npy,.pkl,.csv,.tsv,.json,.vmd,.mvnx,.fbx,.dae,.usd,.usda,.usdc,.usdz,.glb,.gltf,.vrm,.vrma,.zip";

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
    text.textContent = t("reading_drop", { count: new Intl.NumberFormat(language).format(found.length) });
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
  const mark = () => element.classList.toggle("over", depth > 0);
  element.addEventListener("dragenter", (event) => {
    if (![...event.dataTransfer.types].includes("Files")) return;
    event.preventDefault();
    depth += 1;
    mark();
  });
  element.addEventListener("dragleave", () => {
    depth = Math.max(depth - 1, 0);
    mark();
  });
  element.addEventListener("dragover", (event) => {
    if ([...event.dataTransfer.types].includes("Files")) event.preventDefault();
  });
  element.addEventListener("drop", async (event) => {
    event.preventDefault();
    event.stopPropagation();
    depth = 0;
    mark();
    const entries = await entriesOf(event.dataTransfer);
    if (entries.length) onEntries(entries);
  });
  // A drop on a zone inside this one does not come up to it, but it ends the dragging.
  window.addEventListener("drop", () => {
    depth = 0;
    mark();
  }, true);
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
  if (!refused.length) return null;
  return h(
    "details",
    { class: "refused", open: true },
    h("summary", {}, t("refused_title", { count: refused.length })),
    h("div", { class: "scroll" }, h("table", {}, h("tbody", {}, ...refused.map(({ name, reason }) => h("tr", {}, h("th", { scope: "row" }, name), h("td", {}, reason)))))),
  );
}

// A file that misses every zone would replace the page.
for (const name of ["dragover", "drop"]) window.addEventListener(name, (event) => event.preventDefault());
