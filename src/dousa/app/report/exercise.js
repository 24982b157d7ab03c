// Binds the report of an exercise: a press on a repetition plays it in a loop; what is played is marked everywhere.
//
// dousa.bindExercise(root, data, player) -> {unbind()}; root holds the parts of exercise.html.

(() => {
  "use strict";

  const LEAD = 0.3; // s before and after a repetition that its loop shows as well

  function bindExercise(root, data, player) {
    const marked = [...root.querySelectorAll("[data-repetition]")];
    const spanOf = (element) => data.repetitions[Number(element.dataset.repetition)];

    const show = (seconds) => {
      const share = data.duration > 0 ? Math.min(seconds / data.duration, 1) : 0;
      root.style.setProperty("--now-share", share.toFixed(5));
      for (const element of marked) {
        const [start, end] = spanOf(element);
        if (seconds >= start && seconds <= end) element.setAttribute("aria-current", "true");
        else element.removeAttribute("aria-current");
      }
    };

    const press = (event) => {
      const element = event.target.closest("[data-repetition]");
      if (!element) return;
      const [start, end] = spanOf(element);
      const first = Math.max(start - LEAD, 0);
      player.loop(first, Math.min(end + LEAD, data.duration));
      player.seek(first);
      player.play();
      player.reveal();
    };

    root.addEventListener("click", press);
    const end = player.onTime(show);
    show(player.time || 0);
    return Object.freeze({
      unbind() {
        root.removeEventListener("click", press);
        end();
      },
    });
  }

  window.dousa = Object.assign(window.dousa ?? {}, { bindExercise });
})();
