// Film and music of a performance, shown in step with its figures.

import { get, put, remove, upload } from "../core/api.js";
import { $, h, icon, language, t } from "../core/dom.js";
import { attempt } from "../core/notices.js";
import { InStep } from "./in_step.js";
import { Waveform } from "./waveform.js";

const FILES = { film: ".mp4,.mov,.webm,.mkv,.avi,.m4v", music: ".wav,.mp3,.flac,.ogg,.opus,.m4a,.aac" };
const KINDS = ["film", "music"];

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

  /** The beats in the waveform, and the accents of the dance against them as a section of the report. */
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
