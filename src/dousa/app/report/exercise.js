// The report of an exercise: a press on a repetition plays it in a loop; what is played is marked everywhere.
(() => {
  "use strict";

  const LEAD = 0.3; // s before and after a repetition that its loop shows as well
  const read = (id) => JSON.parse(document.getElementById(id).textContent);
  const data = read("report-data");
  const player = dousa.createPlayer(document.getElementById("player"), read("player-data"));
  const marked = [...document.querySelectorAll("[data-repetition]")];

  const show = (seconds) => {
    document.body.style.setProperty("--now-share", (data.duration > 0 ? Math.min(seconds / data.duration, 1) : 0).toFixed(5));
    for (const element of marked) {
      const [start, end] = data.repetitions[Number(element.dataset.repetition)];
      if (seconds >= start && seconds <= end) element.setAttribute("aria-current", "true");
      else element.removeAttribute("aria-current");
    }
  };

  document.addEventListener("click", (event) => {
    const element = event.target.closest("[data-repetition]");
    if (!element) return;
    const [start, end] = data.repetitions[Number(element.dataset.repetition)];
    const first = Math.max(start - LEAD, 0);
    player.loop(first, Math.min(end + LEAD, data.duration));
    player.seek(first);
    player.play();
    const box = document.getElementById("player").getBoundingClientRect();
    if (box.bottom < 120 || box.top > window.innerHeight - 120) document.getElementById("stage").scrollIntoView();
  });
  player.onTime(show);
  show(player.time || 0);
})();
