// Binds the page together: one moment, shown by the player, the cursor of the timeline and the list of errors.
(() => {
  "use strict";

  const LEAD = 0.5; // s before and after an error that its loop shows as well
  const ZOOMS = [1, 2, 4, 8, 16];

  const find = (id) => document.getElementById(id);
  const data = JSON.parse(find("report-data").textContent);
  const lanes = find("lanes");
  const scroll = find("scroll");
  const readout = find("readout");
  const player = dousa.createPlayer(find("player"), JSON.parse(find("player-data").textContent));
  let now = 0;
  let zoom = 0;

  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

  function formatTime(seconds) {
    const tenths = Math.round(Math.max(seconds, 0) * 10);
    return `${Math.floor(tenths / 600)}:${((tenths % 600) / 10).toFixed(1).padStart(4, "0")}`;
  }

  // A place where one value of the moment is said; built once, filled often.
  function addReadout(name) {
    const item = document.createElement("span");
    const value = document.createElement("b");
    item.append(name ? `${name} ` : "", value);
    readout.append(item);
    return value;
  }
  const texts = data.texts;
  const said = {
    time: addReadout(""), matched: addReadout(texts.now_reference), furi: addReadout(texts.furi),
    space: addReadout("d#"), within: addReadout("d*"), lag: addReadout(texts.lag_title), worst: addReadout(texts.now_worst),
  };

  function say(seconds) {
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

  function mark(seconds) {
    for (const [name, spans] of [["event", data.events], ["lapse", data.lapses]]) {
      for (const element of document.querySelectorAll(`[data-${name}]`)) {
        const [start, end] = spans[Number(element.dataset[name])];
        const inside = seconds >= start && seconds <= Math.max(end, start + 0.2);
        if (inside !== (element.getAttribute("aria-current") === "true")) {
          if (inside) element.setAttribute("aria-current", "true");
          else element.removeAttribute("aria-current");
        }
      }
    }
  }

  function follow(share) {
    if (zoom === 0) return;
    const x = share * lanes.clientWidth - scroll.scrollLeft;
    if (x < 0 || x > scroll.clientWidth) scroll.scrollLeft += x - scroll.clientWidth / 4;
  }

  function show(seconds) {
    now = clamp(seconds, 0, data.duration);
    const share = data.duration > 0 ? now / data.duration : 0;
    document.documentElement.style.setProperty("--now-share", share.toFixed(5));
    lanes.setAttribute("aria-valuenow", now.toFixed(2));
    lanes.setAttribute("aria-valuetext", formatTime(now));
    say(now);
    mark(now);
    follow(share);
  }

  // By hand: a loop that the moment lies outside of is left.
  function seek(seconds) {
    const to = clamp(seconds, 0, data.duration);
    if (player.looped && (to < player.looped[0] || to > player.looped[1])) player.loop(null);
    player.seek(to);
    show(to);
  }

  function goTo([start, end]) {
    const first = Math.max(start - LEAD, 0);
    const last = Math.min(Math.max(end, start) + LEAD, data.duration);
    player.loop(first, last);
    seek(first);
    player.play();
    const box = find("player").getBoundingClientRect();
    if (box.bottom < 120 || box.top > window.innerHeight - 120) find("watch").scrollIntoView();
  }

  function secondsAt(event, box) {
    return clamp((event.clientX - box.left) / box.width, 0, 1) * data.duration;
  }

  document.addEventListener("click", (event) => {
    const element = event.target.closest("[data-event], [data-lapse]");
    if (!element) return;
    const { event: error, lapse } = element.dataset;
    goTo(error === undefined ? data.lapses[Number(lapse)] : data.events[Number(error)]);
  });

  for (const plot of [lanes, document.querySelector(".matrix-plot")]) {
    let held = false;
    plot.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || event.target.closest("a, button")) return;
      held = event.pointerType === "mouse";
      if (held) plot.setPointerCapture(event.pointerId);
      seek(secondsAt(event, plot.getBoundingClientRect()));
    });
    plot.addEventListener("pointermove", (event) => {
      if (held) seek(secondsAt(event, plot.getBoundingClientRect()));
    });
    for (const name of ["pointerup", "pointercancel"]) plot.addEventListener(name, () => { held = false; });
  }

  lanes.addEventListener("keydown", (event) => {
    const step = event.shiftKey ? 1 : 0.1;
    const moves = {
      ArrowLeft: now - step, ArrowRight: now + step, ArrowDown: now - step, ArrowUp: now + step,
      PageDown: now - 5, PageUp: now + 5, Home: 0, End: data.duration,
    };
    if (event.target !== lanes || !(event.key in moves)) return;
    event.preventDefault();
    seek(moves[event.key]);
  });

  function setZoom(index) {
    zoom = clamp(index, 0, ZOOMS.length - 1);
    const share = data.duration > 0 ? now / data.duration : 0;
    lanes.style.setProperty("--zoom", ZOOMS[zoom]);
    find("zoom-now").textContent = `${ZOOMS[zoom]}×`;
    scroll.scrollLeft = share * lanes.clientWidth - scroll.clientWidth / 2;
  }
  find("zoom-in").addEventListener("click", () => setZoom(zoom + 1));
  find("zoom-out").addEventListener("click", () => setZoom(zoom - 1));

  // On a phone the pictures of all figures would be a long way to scroll: the first one stays open.
  if (window.innerWidth < 700) {
    for (const card of [...document.querySelectorAll(".shape-card[open]")].slice(1)) card.open = false;
  }

  player.onTime(show);
  show(player.time || 0);
})();
