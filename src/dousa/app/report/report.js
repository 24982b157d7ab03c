// Binds a report together: one moment, shown by the player, the cursor of the timeline and the list of errors.
//
// dousa.bindReport(root, data, player) -> report; root holds the parts of report.html, data is that of the same
// assessment. report.update(data): after parts were replaced by those of another assessment; report.unbind()

(() => {
  "use strict";

  const LEAD = 0.5; // s before and after an error that its loop shows as well
  const ZOOMS = [1, 2, 4, 8, 16];
  const PLOTS = ".lanes, .matrix-plot";

  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

  function formatTime(seconds) {
    const tenths = Math.round(Math.max(seconds, 0) * 10);
    return `${Math.floor(tenths / 600)}:${((tenths % 600) / 10).toFixed(1).padStart(4, "0")}`;
  }

  // Places where the values of the moment are said; built once, filled often.
  function buildReadout(readout, texts) {
    const add = (name) => {
      const item = document.createElement("span");
      const value = document.createElement("b");
      item.append(name ? `${name} ` : "", value);
      readout.append(item);
      return value;
    };
    readout.replaceChildren();
    return {
      time: add(""), matched: add(texts.now_reference), furi: add(texts.furi),
      space: add("d#"), within: add("d*"), lag: add(texts.lag_title), worst: add(texts.now_worst),
    };
  }

  class Report {
    constructor(root, data, player) {
      Object.assign(this, { root, player, now: 0, zoom: 0, held: null, ends: [] });
      this.find = (id) => root.querySelector(`#${id}`);
      this.said = buildReadout(this.find("readout"), data.texts);
      this.listen("click", (event) => this.click(event));
      this.listen("pointerdown", (event) => this.press(event));
      this.listen("pointermove", (event) => this.held && this.seek(this.secondsAt(event, this.held)));
      for (const name of ["pointerup", "pointercancel"]) this.listen(name, () => { this.held = null; });
      this.listen("keydown", (event) => this.key(event));
      this.ends.push(player.onTime((seconds) => this.show(seconds)));
      this.update(data);
    }

    listen(name, action) {
      this.root.addEventListener(name, action);
      this.ends.push(() => this.root.removeEventListener(name, action));
    }

    update(data) {
      this.data = data;
      this.lanes = this.find("lanes");
      this.scroll = this.find("scroll");
      this.held = null;
      this.lanes.parentElement.style.setProperty("--zoom", ZOOMS[this.zoom]);
      this.show(this.player.time || 0);
    }

    say(seconds) {
      const { data, said } = this;
      const at = clamp(Math.round(seconds / data.step), 0, data.space.length - 1);
      const or = (value, show) => (value === null || value === undefined ? "–" : show(value));
      said.time.textContent = formatTime(seconds);
      said.matched.textContent = or(data.matched[at], formatTime);
      said.furi.textContent = data.furi[at] < 0 ? "–" : String(data.furi[at] + 1);
      said.space.textContent = or(data.space[at], (v) => v.toFixed(2));
      said.within.textContent = or(data.within[at], (v) => v.toFixed(2));
      said.lag.textContent = or(data.lag[at], String);
      said.worst.textContent = or(data.worst[at], (k) => `${data.segments[k]} ${data.off[at]}°`);
    }

    mark(seconds) {
      for (const [name, spans] of [["event", this.data.events], ["lapse", this.data.lapses]]) {
        for (const element of this.root.querySelectorAll(`[data-${name}]`)) {
          const [start, end] = spans[Number(element.dataset[name])] ?? [Infinity, Infinity];
          const inside = seconds >= start && seconds <= Math.max(end, start + 0.2);
          if (inside !== (element.getAttribute("aria-current") === "true")) {
            if (inside) element.setAttribute("aria-current", "true");
            else element.removeAttribute("aria-current");
          }
        }
      }
    }

    follow(share) {
      if (this.zoom === 0) return;
      const x = share * this.lanes.clientWidth - this.scroll.scrollLeft;
      if (x < 0 || x > this.scroll.clientWidth) this.scroll.scrollLeft += x - this.scroll.clientWidth / 4;
    }

    show(seconds) {
      const { duration } = this.data;
      this.now = clamp(seconds, 0, duration);
      const share = duration > 0 ? this.now / duration : 0;
      this.root.style.setProperty("--now-share", share.toFixed(5));
      this.lanes.setAttribute("aria-valuenow", this.now.toFixed(2));
      this.lanes.setAttribute("aria-valuetext", formatTime(this.now));
      this.say(this.now);
      this.mark(this.now);
      this.follow(share);
    }

    // By hand: a loop that the moment lies outside of is left.
    seek(seconds) {
      const to = clamp(seconds, 0, this.data.duration);
      const { looped } = this.player;
      if (looped && (to < looped[0] || to > looped[1])) this.player.loop(null);
      this.player.seek(to);
      this.show(to);
    }

    goTo([start, end]) {
      const first = Math.max(start - LEAD, 0);
      const last = Math.min(Math.max(end, start) + LEAD, this.data.duration);
      this.player.loop(first, last);
      this.seek(first);
      this.player.play();
      this.player.reveal();
    }

    secondsAt(event, plot) {
      const box = plot.getBoundingClientRect();
      return clamp((event.clientX - box.left) / box.width, 0, 1) * this.data.duration;
    }

    click(event) {
      if (event.target.closest("#zoom-in")) this.setZoom(this.zoom + 1);
      if (event.target.closest("#zoom-out")) this.setZoom(this.zoom - 1);
      const element = event.target.closest("[data-event], [data-lapse]");
      if (!element && event.target.closest(".lanes") && !event.target.closest("a, button")) this.lanes.focus({ preventScroll: true });
      if (!element) return;
      const { event: error, lapse } = element.dataset;
      this.goTo(error === undefined ? this.data.lapses[Number(lapse)] : this.data.events[Number(error)]);
    }

    press(event) {
      const plot = event.target.closest(PLOTS);
      if (!plot || event.button !== 0 || event.target.closest("a, button")) return;
      if (event.pointerType === "mouse") {
        this.held = plot;
        plot.setPointerCapture(event.pointerId);
      }
      this.seek(this.secondsAt(event, plot));
    }

    key(event) {
      const step = event.shiftKey ? 1 : 0.1;
      const { now } = this;
      const moves = {
        ArrowLeft: now - step, ArrowRight: now + step, ArrowDown: now - step, ArrowUp: now + step,
        PageDown: now - 5, PageUp: now + 5, Home: 0, End: this.data.duration,
      };
      if (event.target !== this.lanes || !(event.key in moves)) return;
      event.preventDefault();
      this.seek(moves[event.key]);
    }

    setZoom(index) {
      this.zoom = clamp(index, 0, ZOOMS.length - 1);
      const share = this.data.duration > 0 ? this.now / this.data.duration : 0;
      this.lanes.parentElement.style.setProperty("--zoom", ZOOMS[this.zoom]);
      this.find("zoom-now").textContent = `${ZOOMS[this.zoom]}×`;
      this.scroll.scrollLeft = share * this.lanes.clientWidth - this.scroll.clientWidth / 2;
    }
  }

  function bindReport(root, data, player) {
    const inner = new Report(root, data, player);
    return Object.freeze({
      update: (values) => inner.update(values),
      unbind: () => inner.ends.splice(0).forEach((end) => end()),
    });
  }

  window.dousa = Object.assign(window.dousa ?? {}, { bindReport });
})();
