// The loudness of a piece of music and its beats, below the timeline of the player and as long as that.

import { h, t } from "../core/dom.js";

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

export class Waveform {
  /** name of the file, start() when it begins; onSeek(s of the performance) */
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
    this.looks = matchMedia("(prefers-color-scheme: dark)");
    this.redraw = () => this.draw();
    this.looks.addEventListener("change", this.redraw);
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
    this.looks.removeEventListener("change", this.redraw);
    this.element.remove();
  }
}
