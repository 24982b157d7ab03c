// Figures of the dance as a list that can be changed: {start_s, end_s, label} in order, side by side.

export const LEAST = 0.1; // s

const round = (seconds) => Math.round(seconds * 1000) / 1000;

/** Places where one figure ends and the next begins. */
export const cutsOf = (figures) => figures.slice(1).map((one) => one.start_s);

export const isSameFigures = (a, b) =>
  a.length === b.length && a.every((one, k) => Math.abs(one.start_s - b[k].start_s) < 0.002 && Math.abs(one.end_s - b[k].end_s) < 0.002 && one.label === b[k].label);

/** A label that no figure has: A, B, ... Z, AA, AB, ... */
export function freshLabel(figures) {
  const taken = new Set(figures.map((one) => one.label));
  const name = (number) => (number < 26 ? "" : name(Math.floor(number / 26) - 1)) + String.fromCharCode(65 + (number % 26));
  for (let number = 0; ; number++) if (!taken.has(name(number))) return name(number);
}

/** The figures with other cuts: moved ones keep their labels, a new one begins a figure with a label of its own. */
export function recut(figures, cuts) {
  const before = cutsOf(figures);
  const edges = [figures[0].start_s, ...cuts, figures.at(-1).end_s].map(round);
  let labels = figures.map((one) => one.label);
  if (cuts.length > before.length) {
    const at = cuts.findIndex((cut, k) => before[k] === undefined || Math.abs(cut - before[k]) > 1e-6);
    labels = [...labels.slice(0, at + 1), freshLabel(figures), ...labels.slice(at + 1)];
  } else if (cuts.length < before.length) {
    const at = before.findIndex((cut, k) => cuts[k] === undefined || Math.abs(cut - cuts[k]) > 1e-6);
    labels = labels.filter((_, k) => k !== at + 1);
  }
  return labels.map((label, k) => ({ start_s: edges[k], end_s: edges[k + 1], label }));
}
