// What others on the local network may look at, or film: the link with its code for a phone, who sees what, and the end of it.

import { get, post, remove } from "./api.js";
import { openDialog } from "./dialog.js";
import { $, h, t } from "./dom.js";
import { attempt, notify } from "./notices.js";

const act = (word, action, kind = "") => h("button", { type: "button", class: `small ${kind}`, dataset: { act: word }, onclick: () => attempt(action) }, t(word));

export async function openSharing(report = null) {
  const place = h("div", { class: "stack sharing", id: "sharing" });
  await fill(place, report);
  openDialog(t("share_title"), place);
}

async function fill(place, report, found = null, inbox = null) {
  const state = found ?? (await get("/share"));
  showState(Boolean(state.address));
  if (!state.possible) {
    place.replaceChildren(h("p", {}, t("share_how")), h("p", {}, h("code", {}, "dousa studio LIB --share")), h("p", { class: "note" }, t("share_how_more")), ...inboxTable(place, report, state.inboxes));
    return;
  }
  if (!state.address) {
    const begin = async () => fill(place, report, await post("/share/begin"));
    place.replaceChildren(h("p", {}, t("share_off")), h("p", { class: "problem-box" }, t("share_warning_all")), ...inboxTable(place, report, state.inboxes), h("div", { class: "foot" }, act("share_begin", begin, "primary")));
    return;
  }
  const link = inbox ?? (await post("/share/links", { report }));
  const { links, inboxes } = await get("/share");
  const kind = inbox ? "inbox" : report ? "one" : "all";
  const film = async () => fill(place, report, null, await post("/share/links", { films: true }));
  const end = async () => fill(place, report, await post("/share/end"));
  place.replaceChildren(
    h("div", { class: "sharing-link" }, h("img", { src: link.code, alt: t("share_code"), width: 220, height: 220 }), h("div", { class: "stack" }, h("p", {}, t(`share_scan_${kind}`)), address(link.url), h("p", { class: "problem-box" }, t(`share_warning_${kind}`)), h("p", { class: "note" }, t("share_certificate")), h("code", { class: "fingerprint" }, state.fingerprint))),
    linkTable(place, report, links),
    ...inboxTable(place, report, inboxes),
    h("div", { class: "foot" }, state.films ? act("share_film", film) : h("span", { class: "note" }, t("share_film_how")), act("share_end", end, "danger")),
  );
}

function address(url) {
  const field = h("input", { type: "text", readonly: true, value: url, "aria-label": t("share_address"), onfocus: () => field.select() });
  const copy = async () => {
    await navigator.clipboard.writeText(url);
    notify(t("share_copied"));
  };
  return h("div", { class: "row sharing-address" }, field, act("share_copy", copy));
}

function linkTable(place, report, links) {
  const revoke = (number) => async () => {
    await post("/share/revoke", { number });
    notify(t("share_revoked"));
    fill(place, report); // the one that is shown is made anew: its old code opens nothing
  };
  const words = ({ report: one, title, inbox }) => (one ? t("share_one", { name: title ?? "–" }) : t(inbox ? "share_inbox" : "share_everything"));
  const rows = links.map((link) => h("tr", {}, h("td", {}, words(link)), h("td", { class: "number" }, act("share_revoke", revoke(link.number)))));
  return h("details", { class: "sharing-links" }, h("summary", {}, t("share_links", { count: links.length })), h("table", {}, h("tbody", {}, ...rows)));
}

/** What came: films are estimated together, each motion can be looked at; empty inboxes are not told. */
function inboxTable(place, report, inboxes) {
  const discard = (batch) => async () => {
    await remove(`/uploads/${batch}`);
    fill(place, report);
  };
  const motionLink = ({ name, motion }) => h("a", { href: `/search?motion=${encodeURIComponent(motion)}` }, name);
  const row = ({ batch, files }) => {
    const films = files.filter((file) => !file.motion);
    const link = films.length ? h("a", { href: `/estimate?batch=${batch}` }, t("share_films", { count: films.length })) : "";
    return h("tr", {}, h("td", {}, h("div", { class: "row" }, link, ...files.filter((file) => file.motion).map(motionLink))), h("td", { class: "number" }, act("share_discard", discard(batch), "danger")));
  };
  const full = inboxes.filter(({ files }) => files.length);
  return full.length ? [h("section", { id: "inboxes" }, h("h3", {}, t("share_inboxes")), h("table", {}, h("tbody", {}, ...full.map(row))))] : [];
}

function showState(on) {
  const button = $("#share-button");
  if (!button) return;
  button.classList.toggle("on", on);
  button.title = t(on ? "share_is_on" : "share_is_off");
}

$("#share-button")?.addEventListener("click", () => attempt(() => openSharing()));
