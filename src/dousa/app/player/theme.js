// When the page's colours change: the system's scheme or contrast, or data-theme on the root element. And what hands do:
// drag, pinch, turn the wheel, press twice.

// This file is also a module of the studio. onTheme returns a function that ends it.
function onTheme(listener) {
  const queries = ["(prefers-color-scheme: dark)", "(prefers-contrast: more)"].map((query) => window.matchMedia(query));
  const observer = new MutationObserver(listener);
  for (const query of queries) query.addEventListener("change", listener);
  observer.observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });
  return () => {
    for (const query of queries) query.removeEventListener("change", listener);
    observer.disconnect();
  };
}

// Dragging turns, two fingers and the wheel zoom, a double click goes back to the beginning.
// hooks: press(event), turn(across, down) in px, scale(factor) -> whether it did, reset(), takesWheel() without a key
function watchHands(canvas, { press, turn, scale, reset, takesWheel }, signal) {
  const on = (name, action) => canvas.addEventListener(name, action, { signal, passive: false });
  const held = new Map();
  const spread = () => {
    const [a, b] = [...held.values()];
    return Math.max(Math.hypot(a[0] - b[0], a[1] - b[1]), 1);
  };
  on("pointerdown", (event) => {
    if (event.button > 0) return;
    press(event);
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, [event.clientX, event.clientY]);
  });
  on("pointermove", (event) => {
    const last = held.get(event.pointerId);
    if (!last) return;
    const before = held.size === 2 ? spread() : 0;
    held.set(event.pointerId, [event.clientX, event.clientY]);
    if (before) scale(spread() / before);
    else turn(event.clientX - last[0], event.clientY - last[1]);
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) on(name, (event) => held.delete(event.pointerId));
  on("dblclick", reset);
  on("wheel", (event) => {
    // A page that is scrolled past the figures goes on scrolling; once they were chosen, they zoom.
    if (!event.ctrlKey && !takesWheel()) return;
    if (scale(Math.exp(-0.0015 * event.deltaY * (event.deltaMode === 1 ? 16 : 1)))) event.preventDefault();
  });
}
