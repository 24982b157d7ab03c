// The report as a page of its own: its data lie in the page, and it is bound once.
(() => {
  "use strict";

  const read = (id) => JSON.parse(document.getElementById(id).textContent);
  const player = dousa.createPlayer(document.getElementById("player"), read("player-data"));
  (dousa.bindReport ?? dousa.bindExercise)(document.body, read("report-data"), player);
})();
