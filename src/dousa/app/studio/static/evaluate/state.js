// What is held against what, as it stands in the address; shapes that the modules of this page share.
//
// A motion here is {motion, start_s, end_s, unit, up} as the interface wants it, null where nothing is said.

const ASIDE = ["start_s", "end_s", "unit", "up", "joint_map"];

const toNumber = (text) => (text === null || text === "" || !Number.isFinite(Number(text)) ? null : Number(text));

/** A name in the address stands for a whole motion; commas occur in names of files. */
const splitNames = (text) => (text ? text.split(/,(?=(?:clip|file|job):)/) : []).filter(Boolean);

export const whole = (motion) => ({ motion });

/** The same motion without what is not said. */
export function plain(ref) {
  const asked = { motion: ref.motion };
  for (const name of ASIDE) if (ref[name] !== null && ref[name] !== undefined) asked[name] = ref[name];
  return asked;
}

export function readAddress() {
  const asked = new URLSearchParams(location.search);
  const motion = asked.get("performance");
  return {
    job: asked.get("job"),
    compare: asked.has("compare") ? asked.get("compare").split(",").filter(Boolean) : null,
    performance: motion ? { motion, start_s: toNumber(asked.get("start_s")), end_s: toNumber(asked.get("end_s")) } : null,
    references: splitNames(asked.get("references")).map(whole),
    side: asked.get("mirror") === "1" ? "mirrored" : "same",
    tempo: asked.get("tempo") === "free" ? "free" : "same",
    repetitions: asked.get("repetitions") === "1",
  };
}

/** The choice of motions in the address: reload shows it again. Parts of references are kept by the job only. */
export function keepChoice({ performance, references, side, tempo, repetitions }) {
  const asked = new URLSearchParams();
  if (performance) {
    asked.set("performance", performance.motion);
    for (const name of ["start_s", "end_s"]) if (performance[name] != null) asked.set(name, String(performance[name]));
  }
  if (references.length) asked.set("references", references.map((ref) => ref.motion).join(","));
  if (side === "mirrored") asked.set("mirror", "1");
  if (tempo === "free") asked.set("tempo", "free");
  if (repetitions) asked.set("repetitions", "1");
  history.replaceState(null, "", `/evaluate${asked.size ? `?${asked}` : ""}`);
}

export const showJob = (id) => history.pushState(null, "", `/evaluate?job=${id}`);
