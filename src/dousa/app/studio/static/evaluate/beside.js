// Film and music of a performance, shown in step with its figures.

import { get, put, remove, upload } from "../core/api.js";
import { $, h, icon, language, t } from "../core/dom.js";
import { attempt } from "../core/notices.js";
import { onTheme } from "../core/theme.js";

// Keeps a film or a piece of music in step with the player: the player leads, and its moments are seconds of the
// performance. start() says when the medium begins.
const DRIFT = 0.12; // s that it may be off while it plays
const STILL = 0.02;

class InStep {
  constructor(media, player, start) {
    Object.assign(this, { media, player, start, held: false });
    this.end = player.onTime(() => this.follow());
    media.addEventListener("loadedmetadata", () => this.follow());
    media.addEventListener("seeked", () => !player.playing && this.follow());
    this.follow();
  }

  follow() {
    const { media, player } = this;
    if (this.held || !media.readyState) return;
    const want = player.time - this.start();
    const inside = want >= 0 && want < (media.duration || 0);
    if (!player.playing || !inside) {
      if (!media.paused) media.pause();
      const to = Math.min(Math.max(want, 0), media.duration || 0);
      if (!media.seeking && Math.abs(media.currentTime - to) > STILL) media.currentTime = to;
      return;
    }
    if (media.playbackRate !== player.speed) media.playbackRate = player.speed;
    if (!media.seeking && Math.abs(media.currentTime - want) > Math.max(DRIFT, DRIFT * player.speed)) media.currentTime = want;
    if (media.paused && !this.asked) {
      this.asked = true;
      media.play().catch(() => {}).finally(() => { this.asked = false; });
    }
  }

  hold(held) {
    this.held = held;
    if (held) this.media.pause();
    else this.follow();
  }

  destroy() {
    this.end();
    this.media.pause();
    this.media.removeAttribute("src");
    this.media.load();
  }
}

// The loudness of a piece of music and its beats, below the timeline of the player and as long as that.
const RATE = 8000; // Hz it is looked at
const MOST_BYTES = 60e6; // of a file: decoded it is many times that

/** Loudest values (n,) of equal parts of a sound file, 0 to 1, and its length in s. */
async function measure(address, parts) {
  const response = await fetch(address, { credentials: "same-origin" });
  const bytes = await response.arrayBuffer();
  if (!response.ok || bytes.byteLength > MOST_BYTES) return null;
  const sound = await new OfflineAudioContext(1, RATE, RATE).decodeAudioData(bytes);
  const values = sound.getChannelData(0);
  const peaks = new Float32Array(parts);
  for (let k = 0; k < values.length; k++) {
    const at = Math.min(Math.floor((k * parts) / values.length), parts - 1);
    peaks[at] = Math.max(peaks[at], Math.abs(values[k]));
  }
  const loudest = Math.max(...peaks, 1e-6);
  return { peaks: peaks.map((one) => one / loudest), duration: sound.duration };
}

class Waveform {
  constructor(player, name, start, onSeek) {
    Object.assign(this, { player, start, sound: null, beats: [] });
    this.canvas = h("canvas", { class: "waveform-canvas" });
    this.now = h("i", { class: "waveform-now" });
    this.element = h("div", { class: "waveform", role: "img", "aria-label": t("waveform", { name }) }, this.canvas, this.now);
    this.element.addEventListener("pointerdown", (event) => {
      const box = this.element.getBoundingClientRect();
      onSeek(((event.clientX - box.left) / box.width) * player.duration);
    });
    this.end = player.onTime((seconds) => this.show(seconds));
    this.watching = new ResizeObserver(() => this.draw());
    this.watching.observe(this.element);
    this.endTheme = onTheme(() => this.draw());
    this.show(player.time);
  }

  async load(address) {
    this.sound = await measure(address, 2000);
    this.draw();
    return Boolean(this.sound);
  }

  setBeats(times) {
    this.beats = times;
    this.element.dataset.beats = String(times.length);
    this.draw();
  }

  show(seconds) {
    this.now.style.left = `${(100 * seconds) / this.player.duration}%`;
  }

  draw() {
    // As wide as the rail of the player, which has room for its thumb.
    const rail = this.player.element.querySelector(".dp-rail")?.getBoundingClientRect();
    const card = this.element.parentElement?.getBoundingClientRect();
    if (rail?.width && card) {
      this.element.style.marginLeft = `${Math.max(rail.left - card.left, 0)}px`;
      this.element.style.width = `${rail.width}px`;
    }
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const ratio = window.devicePixelRatio || 1;
    if (!width) return;
    Object.assign(this.canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    const pen = this.canvas.getContext("2d");
    const { color, caretColor } = getComputedStyle(this.canvas);
    pen.scale(ratio, ratio);
    const start = this.start();
    const scale = width / this.player.duration;
    if (this.sound) {
      const { peaks, duration } = this.sound;
      pen.fillStyle = color;
      for (let x = 0; x < width; x++) {
        const at = Math.floor(((x / scale - start) / duration) * peaks.length);
        const size = peaks[at] ?? 0;
        if (size > 0) pen.fillRect(x, (height * (1 - size)) / 2, 1, Math.max(height * size, 1));
      }
    }
    pen.fillStyle = caretColor;
    for (const beat of this.beats) {
      const x = (beat + start) * scale;
      if (x >= 0 && x <= width) pen.fillRect(Math.round(x), 0, 1.5, height);
    }
    this.element.dataset.drawn = this.sound ? "sound" : "beats";
  }

  destroy() {
    this.end();
    this.watching.disconnect();
    this.endTheme();
    this.element.remove();
  }
}

const FILES = { film: ".mp4,.mov,.webm,.mkv,.avi,.m4v", music: ".wav,.mp3,.flac,.ogg,.opus,.m4a,.aac" };
const KINDS = Object.keys(FILES);

const soundOf = (media) => h("label", { class: "check" }, h("input", { type: "checkbox", checked: !media.muted, onchange: (event) => { media.muted = !event.target.checked; } }), t("mute"));

export class Beside {
  /** root: the report; job: its number */
  constructor(root, job, player) {
    Object.assign(this, { root, job, player, now: {}, shown: {} });
    this.place = $(".player-card", root);
    this.bar = h("div", { class: "beside-bar", id: "beside", "aria-label": t("beside"), role: "group" });
    this.place.append(this.bar);
    this.load();
  }

  async load() {
    const now = await attempt(() => get(`/evaluations/${this.job}/companions`));
    if (now && !this.ended) this.show(now);
  }

  show(now) {
    for (const kind of KINDS) {
      const [before, after] = [this.now[kind], now[kind]];
      const same = before && after && before.batch === after.batch && before.name === after.name;
      if (same) continue;
      this.shown[kind]?.destroy();
      delete this.shown[kind];
      if (after) this.shown[kind] = kind === "film" ? this.makeFilm(after) : this.makeMusic(after);
    }
    this.now = now;
    this.drawBar();
    for (const one of Object.values(this.shown)) one.refresh();
  }

  address(kind) {
    const { batch, name } = this.now[kind];
    return `/api/evaluations/${this.job}/companions/${kind}/file?of=${batch}-${encodeURIComponent(name)}`;
  }

  start(kind) {
    return this.now[kind]?.start_s ?? 0;
  }

  async keep(kind, start) {
    const { batch, name } = this.now[kind];
    const now = await put(`/evaluations/${this.job}/companions/${kind}`, { batch, name, start_s: Math.round(start * 1000) / 1000 });
    this.show(now);
    if (kind === "music") this.showBeats();
  }

  drawBar() {
    this.bar.replaceChildren(...KINDS.map((kind) => (this.now[kind] ? this.describe(kind) : this.adder(kind))));
  }

  adder(kind) {
    const input = h("input", { type: "file", accept: FILES[kind], hidden: true, id: `${kind}-file`, "aria-label": t(`add_${kind}`) });
    input.addEventListener("change", () => attempt(() => this.add(kind, input.files[0])));
    return h("span", {}, input, h("button", { type: "button", class: "small", id: `add-${kind}`, title: t(`add_${kind}_title`), onclick: () => input.click() }, t(`add_${kind}`)));
  }

  async add(kind, file) {
    if (!file) return;
    const button = $(`#add-${kind}`, this.bar);
    if (button) Object.assign(button, { disabled: true, textContent: t("loading") });
    try {
      const came = await upload(file);
      this.show(await put(`/evaluations/${this.job}/companions/${kind}`, { batch: came.batch, name: came.files[0].name }));
    } finally {
      if (!this.ended) this.drawBar();
    }
  }

  describe(kind) {
    const { name } = this.now[kind];
    const field = h("input", { type: "number", step: "0.1", id: `${kind}-start`, value: String(this.start(kind)), title: t("begins_at_title") });
    field.addEventListener("change", () => Number.isFinite(field.valueAsNumber) && attempt(() => this.keep(kind, field.valueAsNumber)));
    const away = h("button", { type: "button", class: "quiet small icon", "aria-label": t("take_beside_away", { name }), title: t("take_beside_away", { name }), onclick: () => attempt(async () => this.show(await remove(`/evaluations/${this.job}/companions/${kind}`))) }, icon("close"));
    return h("span", { class: "beside-one", dataset: { kind } }, h("b", { class: "beside-name", title: name }, name), h("label", { class: "beside-start" }, t("begins_at"), field), ...this.shown[kind].tools(), away);
  }

  makeFilm({ name }) {
    const video = h("video", { class: "beside-film", muted: true, playsinline: true, preload: "auto", "aria-label": t("film_of", { name }) });
    video.muted = true;
    const problem = h("p", { class: "note bad", hidden: true }, t("film_unreadable"));
    const box = h("figure", { class: "film-box" }, video, problem);
    this.place.prepend(box);
    const follower = new InStep(video, this.player, () => this.start("film"));
    video.addEventListener("error", () => {
      problem.hidden = !video.getAttribute("src");
      video.hidden = !problem.hidden;
    });
    video.addEventListener("loadedmetadata", () => this.place.classList.toggle("upright", video.videoHeight > video.videoWidth));
    this.place.classList.add("has-film");
    const match = () => {
      if (!follower.held) {
        this.player.pause();
        follower.hold(true);
        video.controls = true;
        this.drawBar();
        return;
      }
      video.controls = false;
      const start = this.player.time - video.currentTime;
      follower.hold(false);
      attempt(() => this.keep("film", start));
    };
    return {
      tools: () => [soundOf(video), h("button", { type: "button", class: "small", id: "match-film", title: t("match_film_title"), "aria-pressed": String(follower.held), onclick: match }, t(follower.held ? "matched_film" : "match_film"))],
      refresh: () => {
        const address = this.address("film");
        if (video.getAttribute("src") !== address) video.src = address;
        follower.follow();
      },
      destroy: () => {
        follower.destroy();
        box.remove();
        this.place.classList.remove("has-film", "upright");
      },
    };
  }

  makeMusic({ name }) {
    const audio = h("audio", { preload: "auto" });
    const wave = new Waveform(this.player, name, () => this.start("music"), (seconds) => this.player.seek(seconds));
    const follower = new InStep(audio, this.player, () => this.start("music"));
    this.says = h("p", { class: "note", id: "beats-say", role: "status" });
    this.bar.before(wave.element, this.says);
    this.wave = wave;
    return {
      tools: () => [soundOf(audio)],
      refresh: () => {
        const address = this.address("music");
        if (audio.getAttribute("src") !== address) {
          audio.src = address;
          this.loadWave(wave, address);
        }
        wave.draw();
        follower.follow();
      },
      destroy: () => {
        follower.destroy();
        wave.destroy();
        this.says.remove();
        $("#beats", this.root)?.remove();
      },
    };
  }

  async loadWave(wave, address) {
    this.showBeats();
    try {
      await wave.load(address);
    } catch {
      this.says.textContent = t("music_unreadable");
    }
  }

  async showBeats() {
    const { wave } = this;
    try {
      const { times_s: times, tempo_bpm: tempo, section, problem } = await get(`/evaluations/${this.job}/beats`, { language });
      if (this.ended || wave !== this.wave || !times) return;
      wave.setBeats(times);
      this.says.textContent = [t("beats_found", { count: times.length, tempo: Math.round(tempo) }), problem].filter(Boolean).join(" · ");
      const part = document.createElement("template");
      part.innerHTML = section;
      $("#beats", this.root)?.remove();
      $("#analysis", this.root).before(part.content);
    } catch (error) {
      if (!this.ended) this.says.textContent = error.message;
    }
  }

  destroy() {
    this.ended = true;
    for (const one of Object.values(this.shown)) one.destroy();
  }
}
