// Addresses of this page: what is shown stands in them, so that a reload shows it again.

/** The page with other parameters, in the language that was asked for. */
export function addressOf(params) {
  const query = new URLSearchParams(params);
  const language = new URLSearchParams(location.search).get("lang");
  if (language) query.set("lang", language);
  const text = query.toString();
  return text ? `/estimate?${text}` : "/estimate";
}
