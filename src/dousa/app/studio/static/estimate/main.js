// The page of estimation: before (files, person, a look) and while or after (?job=ID).

import { $ } from "../core/dom.js";
import { Editor } from "../masks/editor.js";
import { addressOf, showSetup } from "./setup.js";
import { Watching } from "./watch.js";

let shown = null;

function route() {
  shown?.end();
  shown = null;
  const asked = new URLSearchParams(location.search);
  const job = asked.get("job");
  const masks = job ? null : asked.get("masks");
  const onJob = (id) => go({ job: id });
  const onMasks = (id, of) => go(of ? { masks: id, of } : { masks: id });
  $("#setup").hidden = Boolean(job || masks);
  $("#watch").hidden = !job;
  $("#masks").hidden = !masks;
  if (masks) shown = new Editor(masks, { of: asked.get("of"), onJob, startOver: () => go({}) });
  else if (job) shown = new Watching(job, { startOver: () => go({}), onJob, onMasks });
  else showSetup({ batch: asked.get("batch"), onJob, onMasks });
}

function go(params) {
  history.pushState(null, "", addressOf(params));
  route();
  window.scrollTo(0, 0);
}

window.addEventListener("popstate", route);
route();
