// The interface of the studio, as any program would use it.

import { language, t } from "./dom.js";

class Problem extends Error {
  constructor(message, status) {
    super(message);
    this.status = status;
  }
}

async function call(method, path, { body, headers, signal, params } = {}) {
  const query = params ? `?${new URLSearchParams(Object.entries(params).filter(([, value]) => value != null && value !== ""))}` : "";
  let response;
  try {
    response = await fetch(`/api${path}${query}`, { method, body, headers: { "accept-language": language, ...headers }, signal, credentials: "same-origin" });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem(t("unreachable"), 0);
  }
  if (response.ok) return response;
  const text = await response.text();
  let problem = text;
  try {
    problem = JSON.parse(text).problem ?? text;
  } catch {
    // not from us: the text says what there is to say
  }
  throw new Problem(problem || `${response.status}`, response.status);
}

const asJson = (value) => ({ body: JSON.stringify(value ?? {}), headers: { "content-type": "application/json" } });

export const get = async (path, params, signal) => (await call("GET", path, { params, signal })).json();
const getBytes = async (path, params, signal) => (await call("GET", path, { params, signal })).arrayBuffer();
export const post = async (path, value, signal) => (await call("POST", path, { ...asJson(value), signal })).json();
export const postBytes = async (path, body, params, signal) => (await call("POST", path, { body, params, signal })).json();
export const put = async (path, value) => (await call("PUT", path, asJson(value))).json();
export const remove = async (path) => (await call("DELETE", path)).json();

/** Upload one file; -> {batch, files: [{name, bytes, motion, labels_of}], refused: [{name, reason}]}. */
export const upload = (file, { name = file.name, batch, signal } = {}) => postBytes("/uploads", file, { name, batch }, signal);

/** The bytes of the small figures of clips, by their numbers; null for one that cannot be drawn. */
export async function getFigures(clips) {
  const bytes = await (await call("POST", "/clips/thumbnails", asJson({ clips }))).arrayBuffer();
  const size = bytes.byteLength / clips.length;
  // Copies, so that one figure does not hold the bytes of all.
  const figures = clips.map((_, place) => new Uint8Array(bytes.slice(place * size, (place + 1) * size)));
  return figures.map((figure) => (figure.some(Boolean) ? figure : null));
}

/** The figure of a motion on a canvas of the page; undefined if it cannot be drawn: its name is there all the same. */
export async function drawFigure(canvas, motion, options) {
  const draw = (bytes) => (canvas.isConnected ? window.dousa.createMiniature(canvas, bytes, options) : undefined);
  return getBytes("/motions/miniature", motion).then(draw).catch(() => undefined);
}

const AT_ONCE = 4;

/** Upload entries [{file, path}] into one batch, some at a time; refused files do not stop the others.
 *  onProgress(done, total), onBatch(name) as soon as there is one -> {batch (null if nothing was taken), files, refused: [{name, reason}]} */
export async function uploadAll(entries, { batch = null, onProgress = () => {}, onBatch = () => {}, signal } = {}) {
  const answer = { batch, files: [], refused: [] };
  const taken = []; // by place: those that end sooner keep the order in which they were chosen
  let [next, done] = [0, 0];
  const take = async () => {
    const place = next++;
    const { file, path } = entries[place];
    try {
      const came = await upload(file, { name: path, batch: answer.batch, signal });
      answer.batch = came.batch;
      onBatch(came.batch);
      taken[place] = came.files;
      answer.refused.push(...came.refused);
    } catch (error) {
      if (!(error instanceof Problem) || error.status === 0) throw error;
      answer.refused.push({ name: path, reason: error.message });
    }
    onProgress(++done, entries.length);
  };
  while (next < entries.length && answer.batch === null) await take(); // the first one taken makes the batch
  const lane = async () => {
    while (next < entries.length) await take();
  };
  await Promise.all(Array.from({ length: AT_ONCE }, lane));
  answer.files = taken.flat();
  return answer;
}
