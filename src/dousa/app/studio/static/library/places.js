// What of the page's state stands in its address besides the filter, and what is kept for who comes back.

import { get } from "../core/api.js";
import { keep, recall } from "../core/dom.js";

/** Set or, with null, take away parts of the address without a new entry in the history. */
export function inAddress(values) {
  const address = new URL(location.href);
  for (const [name, value] of Object.entries(values)) {
    if (value === null) address.searchParams.delete(name);
    else address.searchParams.set(name, value);
  }
  history.replaceState(null, "", address);
}

export const fromAddress = (name) => new URLSearchParams(location.search).get(name);

const KEY = "dousa-library-place";
const MOST_KEPT = 20_000;
const FEW = 20; // clips of which the bar of actions wants to know more

/** Keep what is chosen and how far the page is scrolled, for who goes elsewhere and comes back in this tab. */
export function keepPlace({ selection, grid, scroll }) {
  window.addEventListener("pagehide", () => {
    const place = { address: location.search, top: scroll.top, active: grid.active, ids: selection.ids.slice(0, MOST_KEPT) };
    keep("sessionStorage", KEY, place);
  });
}

/** Go back there, if the page was left with this address and is come back to or loaded again. */
export async function findPlace({ selection, grid, scroll }) {
  const [entry] = performance.getEntriesByType("navigation");
  if (!["back_forward", "reload"].includes(entry?.type)) return;
  const place = recall("sessionStorage", KEY);
  if (place?.address !== location.search) return;
  try {
    grid.activate(Math.min(place.active, Math.max(grid.total - 1, 0)));
    scroll.to(place.top);
    if (place.ids.length) selection.restore(await findAgain(place.ids));
  } catch {
    // nothing that can be read
  }
}

export async function findAgain(numbers) {
  const there = new Set((await get("/clips/ids")).ids);
  const left = numbers.filter((number) => there.has(number));
  return left.length > FEW ? left.map((number) => [number, null]) : Promise.all(left.map(async (number) => [number, await get(`/clips/${number}`)]));
}
