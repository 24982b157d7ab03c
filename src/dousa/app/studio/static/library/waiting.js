// What a dialog shows while its job is under way.

import { foot } from "../core/dialog.js";
import { h, t } from "../core/dom.js";
import { stopJob } from "../core/jobs.js";
import { attempt } from "../core/notices.js";

/** What is said of a job, how far it is, notes, and buttons to stop it and to close the dialog. */
export const waiting = (job, said, close, ...notes) => [
  h("p", { role: "status" }, said),
  h("progress", { max: String(Math.max(job.total, 1)), value: job.total ? String(job.done) : null, "aria-label": t(`kind_${job.kind}`) }),
  ...notes,
  foot(h("button", { type: "button", class: "danger", disabled: job.state === "stopping", onclick: () => attempt(() => stopJob(job.id)) }, t("stop")), h("button", { type: "button", onclick: close }, t("close"))),
];
