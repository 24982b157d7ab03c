// The report as a page of its own: its data lie in the page, and it is bound once.
(() => {
  "use strict";

  const read = (id) => JSON.parse(document.getElementById(id).textContent);
  const player = dousa.createPlayer(document.getElementById("player"), read("player-data"));

  // On a phone the pictures of all figures would be a long way to scroll: the first one stays open.
  if (window.innerWidth < 700) {
    for (const card of [...document.querySelectorAll(".shape-card[open]")].slice(1)) card.open = false;
  }
  (dousa.bindReport ?? dousa.bindExercise)(document.body, read("report-data"), player);
})();
