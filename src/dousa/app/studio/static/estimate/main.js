// The page of estimation: before (files, person, a look) and while or after (?job=ID).

import { $ } from "../core/dom.js";
import { addressOf } from "./address.js";
import { showSetup } from "./setup.js";
import { watchEstimation } from "./watch.js";

let leave = () => {};

function route() {
  leave();
  leave = () => {};
  const asked = new URLSearchParams(location.search);
  const job = asked.get("job");
  $("#setup").hidden = Boolean(job);
  $("#watch").hidden = !job;
  if (job) leave = watchEstimation(job, { startOver: () => go({}), onJob: (id) => go({ job: id }) });
  else showSetup({ batch: asked.get("batch"), onJob: (id) => go({ job: id }) });
}

function go(params) {
  history.pushState(null, "", addressOf(params));
  route();
  window.scrollTo(0, 0);
}

window.addEventListener("popstate", route);
route();
