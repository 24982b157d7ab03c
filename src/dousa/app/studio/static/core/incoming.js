// Files that are looked at without being added to the library.

import { uploadAll } from "./api.js";
import { t } from "./dom.js";
import { attempt, notify } from "./notices.js";

/** Upload entries [{file, path}]; -> the names of the motions among them. What cannot be used is told. */
export async function takeMotions(entries) {
  const came = await attempt(() => uploadAll(entries));
  if (!came) return [];
  for (const { name, reason } of came.refused) notify(`${name}: ${reason}`, "problem");
  const motions = came.files.filter((file) => file.motion).map((file) => file.motion);
  if (!motions.length && !came.refused.length) notify(t("no_motion_file"), "problem");
  return motions;
}
