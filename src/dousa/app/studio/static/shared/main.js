// What others on the network see: a list of reports and the clips of the library, or one report. Nothing here writes.

import { get } from "../core/api.js";
import { $, h, language, t } from "../core/dom.js";
import { showLibrary } from "./clips.js";
import { Report } from "./report.js";

const report = new Report($("#report"));
const when = new Intl.DateTimeFormat(language, { dateStyle: "medium", timeStyle: "short" });

function reportRow({ id, name, created_s: created, repetitions }) {
  const about = [when.format(new Date(1000 * created)), repetitions ? t("exercise") : ""].filter(Boolean).join(" · ");
  return h("li", {}, h("a", { class: "card shared-report", href: `/report?job=${id}` }, h("b", {}, name || t("unnamed")), h("span", { class: "note" }, about)));
}

async function showList() {
  const { reports, everything } = await get("/reports");
  if (!everything && reports.length === 1) {
    location.replace(`/report?job=${reports[0].id}`);
    return;
  }
  $("#shared-reports").replaceChildren(...(reports.length ? reports.map(reportRow) : [h("li", { class: "note" }, t("no_reports"))]));
  $("#shared-list").hidden = false;
  if (everything) showLibrary();
}

async function showReport(id) {
  const { reports, everything } = await get("/reports");
  const asked = reports.find((one) => one.id === id);
  $("#home").href = everything ? "/" : location.pathname + location.search;
  const name = asked?.name || t("unnamed");
  $("#title").textContent = name;
  $("#title").className = "sr"; // the report has a title of its own
  document.title = `${name} - dousa`;
  const file = asked?.repetitions ? "exercise" : "report";
  const links = [h("a", { class: "button small", id: "download", href: `/api/reports/${id}/${file}.html?language=${language}`, download: "" }, t("download_report"))];
  if (everything) links.unshift(h("a", { class: "button small", href: "/" }, t("all_shared")));
  $("#tools").replaceChildren(...links);
  $("#tools").hidden = false;
  await report.show(id, Boolean(asked?.repetitions));
}

const asked = new URLSearchParams(location.search).get("job");
try {
  await (location.pathname === "/report" && asked ? showReport(asked) : showList());
} catch (error) {
  $("#problem").textContent = error.message;
  $("#problem").hidden = false;
}
