// When the page's colours change: the system's scheme or contrast, or data-theme on the root element.

const themeListeners = new Set();

function startWatchingTheme() {
  const tell = () => {
    for (const listener of [...themeListeners]) listener();
  };
  for (const query of ["(prefers-color-scheme: dark)", "(prefers-contrast: more)"]) {
    window.matchMedia(query).addEventListener("change", tell);
  }
  new MutationObserver(tell).observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });
}

// Returns a function that ends it. Watching starts with the first listener and goes on: it costs nothing.
function onTheme(listener) {
  if (!startWatchingTheme.done) {
    startWatchingTheme.done = true;
    startWatchingTheme();
  }
  themeListeners.add(listener);
  return () => themeListeners.delete(listener);
}
