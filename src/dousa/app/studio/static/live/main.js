// The live page: the camera, the skeleton over it, what it is and how good it is.

import { get, post, postBytes, remove } from "../core/api.js";
import { $, baseName, formatSeconds, h, t, wholeGrade } from "../core/dom.js";
import { pickClips } from "../core/pick.js";

// The skeleton over the picture of the camera.
const SURE = 0.5;
const LIMB = { left: "#4ab8ff", right: "#ffa24a", middle: "#35e0a8" };
const FIRST_OF_BODY = 11; // before it the face, whose points are odd at the left; behind it odd numbers are left too

const sideOf = (one, other) => (one % 2 === other % 2 ? (one % 2 ? "left" : "right") : "middle");

/** Draw a person {points: [[x, y] shares], visibility}, or nobody (null), on the picture that was measured, if any. */
export function drawPerson(canvas, person, bones, picture = null) {
  const context = canvas.getContext("2d");
  context.clearRect(0, 0, canvas.width, canvas.height);
  // Over the newest picture of the camera the skeleton would trail behind the body.
  if (picture) context.drawImage(picture, 0, 0, canvas.width, canvas.height);
  if (!person) return;
  const place = person.points.map(([x, y]) => [x * canvas.width, y * canvas.height]);
  const unit = Math.max(canvas.width, canvas.height) / 640;
  context.lineCap = "round";
  for (const pass of ["#0009", null]) {
    for (const [one, other] of bones) {
      const sure = Math.min(person.visibility[one], person.visibility[other]);
      if (sure < 0.15) continue;
      Object.assign(context, { strokeStyle: pass ?? LIMB[sideOf(one, other)], lineWidth: (pass ? 7 : 4) * unit, globalAlpha: sure < SURE ? 0.4 : 1 });
      context.beginPath();
      context.moveTo(...place[one]);
      context.lineTo(...place[other]);
      context.stroke();
    }
  }
  context.globalAlpha = 1;
  context.fillStyle = "#ffffff";
  for (let number = FIRST_OF_BODY; number < place.length; number += 1) {
    if (person.visibility[number] < SURE) continue;
    context.beginPath();
    context.arc(...place[number], 2.6 * unit, 0, 2 * Math.PI);
    context.fill();
  }
}

// The camera of this machine: pictures of it go to the studio one after the other, over one connection.
const [LONGEST, QUALITY] = [640, 0.8]; // px of what is looked at; more tells the networks nothing

class Camera {
  constructor(video) {
    this.video = video;
    this.canvas = document.createElement("canvas");
  }

  /** Ask for the camera; -> [width, height] of what is looked at. */
  async open() {
    if (!navigator.mediaDevices) throw new Error(location.origin);
    this.stream = await navigator.mediaDevices.getUserMedia({ video: { width: { ideal: 1280 }, height: { ideal: 720 }, facingMode: "user" }, audio: false });
    this.video.srcObject = this.stream;
    await this.video.play();
    const { videoWidth: width, videoHeight: height } = this.video;
    const factor = Math.min(1, LONGEST / Math.max(width, height));
    Object.assign(this.canvas, { width: Math.round(width * factor), height: Math.round(height * factor) });
    return [this.canvas.width, this.canvas.height];
  }

  take() {
    this.canvas.getContext("2d").drawImage(this.video, 0, 0, this.canvas.width, this.canvas.height);
    return new Promise((resolve) => this.canvas.toBlob(resolve, "image/jpeg", QUALITY));
  }

  close() {
    for (const track of this.stream?.getTracks() ?? []) track.stop();
    this.video.srcObject = null;
    this.stream = null;
  }
}

const KEPT = 40; // settled labels that are shown
const SMOOTH = 0.15; // share of the newest picture in what is said of the speed

const camera = new Camera($("#live-video"));
const state = { session: null, bones: [], reference: null, running: false, trained: false, latency: null, gap: null, last: 0 };

const problem = (text) => $("#live-problem").replaceChildren(...(text ? [h("p", { class: "problem-box" }, text)] : []));

async function begin() {
  const known = await get("/live").catch((error) => ({ problem: error.message, bones: [] }));
  Object.assign(state, { bones: known.bones, trained: known.trained });
  problem(known.problem);
  $("#live-vmc").textContent = known.vmc ? t("vmc", { address: known.vmc }) : "";
  $("#live-start").disabled = Boolean(known.problem);
  const asked = new URLSearchParams(location.search).get("reference");
  if (asked) state.reference = { motion: asked, name: asked };
  if (asked) get("/motions/info", { motion: asked }).then((info) => setReference({ motion: asked, name: info.name }), () => setReference(null));
  showReference();
  showLabel(null);
}

function setReference(reference) {
  state.reference = reference;
  const query = new URLSearchParams(location.search);
  if (reference) query.set("reference", reference.motion);
  else query.delete("reference");
  history.replaceState(null, "", `/live${query.size ? `?${query}` : ""}`);
  showReference();
  if (state.running) restart();
}

function showReference() {
  $("#live-reference").textContent = state.reference ? t("other_reference") : t("pick_reference");
  $("#live-no-reference").hidden = !state.reference;
  showGrade(null);
}

async function pick() {
  const [clip] = await pickClips({ title: t("pick_reference") });
  if (clip) setReference({ motion: `clip:${clip.id}`, name: baseName(clip.path) });
}

function showLabel(label) {
  const [large, note] = [$("#live-label"), $("#live-label-note")];
  large.textContent = "";
  if (!state.trained || label?.state === "none") note.textContent = label?.problem ?? t("label_untrained");
  else if (label?.state === "learning") note.textContent = t("label_learning");
  else if (!label || label.confidence === null) note.textContent = t("label_none");
  else {
    large.textContent = label.category ?? (label.perhaps ? t("perhaps", { category: label.guess }) : "");
    note.textContent = label.category || label.perhaps ? t(label.perhaps ? "label_perhaps" : "label_sure", { percent: Math.round(100 * label.confidence) }) : t("label_unknown");
  }
  for (const one of label?.settled ?? []) addPast(one);
}

const told = new Set();

function addPast({ category: named, perhaps, guess, start_s: start, end_s: end }) {
  const category = named ?? (perhaps ? t("perhaps", { category: guess }) : null);
  const key = `${start} ${end}`;
  if (!category || told.has(key)) return;
  told.add(key);
  const list = $("#live-past");
  list.prepend(h("li", {}, h("span", {}, category), h("span", {}, formatSeconds(end - start))));
  while (list.children.length > KEPT) list.lastChild.remove();
}

function showGrade(grade) {
  const [large, note] = [$("#live-grade"), $("#live-grade-note")];
  large.textContent = grade?.score == null ? "" : wholeGrade(grade.score);
  if (!state.reference) note.textContent = t("grade_none");
  else if (!grade || grade.score === null) note.textContent = `${state.reference.name}. ${t("grade_soon")}`;
  else note.textContent = [t("grade_of", { seconds: grade.seconds.toFixed(0) }), describeNow(grade)].filter(Boolean).join(". ");
}

function describeNow({ wrong_names: wrong, lag_ms: lag, matched_s: matched }) {
  if (matched === null) return ""; // nothing like it in the reference
  const now = wrong ? t("grade_wrong", { names: wrong }) : t("grade_good");
  if (lag === null || Math.abs(lag) < 100) return now;
  return `${now}. ${t(lag > 0 ? "grade_lag_late" : "grade_lag_early", { ms: Math.abs(lag) })}`;
}

function showSpeed(taken, ms) {
  const now = performance.now();
  const blend = (old, fresh) => (old === null ? fresh : old + SMOOTH * (fresh - old));
  state.latency = blend(state.latency, now - taken);
  if (state.last) state.gap = blend(state.gap, now - state.last);
  state.last = now;
  $("#live-latency").textContent = t("latency_value", { ms: Math.round(state.latency) });
  $("#live-parts").textContent = t("latency_parts", { keypoints: Math.round(ms.keypoints), judging: Math.round(ms.judging) });
  if (state.gap) $("#live-rate").textContent = t("rate_value", { rate: (1000 / state.gap).toFixed(1) });
}

async function start() {
  problem(null);
  $("#live-hint").textContent = t("waiting_camera");
  try {
    const size = await camera.open();
    $("#live-stage").style.setProperty("--shape", `${size[0]} / ${size[1]}`);
    Object.assign($("#live-drawing"), { width: size[0], height: size[1] });
  } catch (error) {
    $("#live-hint").textContent = "";
    problem(t("no_camera", { reason: error.message || error.name }));
    return;
  }
  $("#live-start").hidden = true;
  $("#live-stop").hidden = false;
  $("#live-stop").focus();
  await restart();
}

async function restart() {
  state.abort?.abort();
  const mine = (state.abort = new AbortController());
  Object.assign(state, { running: true, latency: null, gap: null, last: 0 });
  try {
    const references = state.reference ? [{ motion: state.reference.motion }] : [];
    const { id } = await post("/live", { references });
    state.session = id;
    await watch(id, mine.signal);
  } catch (error) {
    if (mine.signal.aborted) return;
    stop();
    problem(error.message);
  }
}

// One picture at a time: whoever is slower sees fewer of them, not old ones.
async function watch(session, signal) {
  while (!signal.aborted) {
    const taken = performance.now();
    const picture = await camera.take();
    const found = await postBytes(`/live/${session}/picture`, picture, { seconds: (taken / 1000).toFixed(3) }, signal);
    if (signal.aborted) return;
    drawPerson($("#live-drawing"), found.person, state.bones, camera.canvas);
    const hint = found.person ? "" : t("nobody");
    if ($("#live-hint").textContent !== hint) $("#live-hint").textContent = hint;
    showLabel(found.label);
    showGrade(found.grade);
    showSpeed(taken, found.ms);
  }
}

function stop() {
  state.abort?.abort();
  if (state.session) remove(`/live/${state.session}`).catch(() => {});
  Object.assign(state, { session: null, running: false });
  camera.close();
  $("#live-hint").textContent = "";
  drawPerson($("#live-drawing"), null, []);
  $("#live-stop").hidden = true;
  $("#live-start").hidden = false;
  $("#live-start").focus();
}

$("#live-start").addEventListener("click", start);
$("#live-stop").addEventListener("click", stop);
$("#live-reference").addEventListener("click", pick);
$("#live-no-reference").addEventListener("click", () => setReference(null));
window.addEventListener("pagehide", () => camera.close());
begin();
