// What of the page's state stands in its address besides the filter.

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
