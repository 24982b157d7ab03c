// What the readers and the interface say of a problem, in the words and the language of the pages. They speak to
// programs and to the command line too; a sentence that is not known here is shown as it came.

import { t } from "./dom.js";

const SENTENCES = [
  [/the file is empty; was the copy interrupted\?/, "say_empty"],
  [/the content is not that of a (\.\w+) file/, "say_other_content"],
  [/expected a motion \(.*?\.zip of them, got (.+)/, "say_no_motion"],
  [/'.*': a character in this name is not one for file names; rename the file/s, "say_bad_name"],
  [/'.*': expected a shorter name without a dot or space at its end/s, "say_long_name"],
  [/(?:performance|reference)(?: \d+)?: expected a motion of at least ([\d.]+) s and \d+ frames, got .*/, "say_too_short"],
  [/no \.asf skeleton found.*--skeleton FILE\.asf/, "say_no_skeleton"],
  [/several skeletons may fit: (.*?) in .*; name one with --skeleton/, "say_skeletons"],
  [/bone '(.*?)' is not in .*; name the right skeleton with --skeleton/, "say_other_skeleton"],
  [/no person is as small or as tall as this; is the unit right \(--unit\)\?/, "say_no_person"],
  [/the header declares (\d+) frames, the file holds (\d+); is it truncated\?/, "say_frames_missing"],
  [/expected (\d+) channel values, got (\d+); is the file truncated\?/, "say_values_missing"],
  [/is the file truncated\?/, "say_truncated"],
  [/expected at most ([\d.]+) MB$/, "say_too_large"],
  [/.*: no clip(?: or take)? \d+; see: dousa list/, "say_no_clip"],
  [/no clip \d+ in the library; was it removed\? Load the list again/, "say_no_clip"],
  [/.* is the take .*; look into takes with: dousa find, dousa label/, "say_whole_take"],
  [/no job '.*?'; see GET \/api\/jobs\S*/, "say_no_job"],
  [/no batch of files .*; upload the files again|no file .* in batch .*; upload it again|\S* is not there any more; make or upload it again/, "say_no_file"],
  [/the disk is full, so this was not kept; free some space and try again/, "say_disk_full"],
  [/the token is missing or wrong: .*/, "say_new_token"],
];

/** One sentence, or several on lines of their own. */
export function inWords(problem) {
  const known = SENTENCES.find(([form]) => form.test(problem));
  if (!known) return problem;
  const [form, word] = known;
  return problem.replace(form, (...found) => t(word, found)).replace(/(^|[: ])line (\d+): /, (_, before, line) => before + t("say_line", { line }));
}
