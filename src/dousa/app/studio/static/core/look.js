// The two buttons of every page for language, and for light and dark; both are remembered in cookies.

import { $, icon, language, t } from "./dom.js";

const YEAR = 31536000;
const keep = (name, value) => {
  document.cookie = `${name}=${value}; path=/; max-age=${value ? YEAR : 0}; samesite=lax`;
};

$("#language-button").addEventListener("click", () => {
  keep("dousa_lang", language === "en" ? "ja" : "en");
  const address = new URL(location.href);
  address.searchParams.delete("lang");
  location.assign(address);
});

const THEMES = ["system", "light", "dark"];
const THEME_ICONS = { system: "half", light: "sun", dark: "moon" };

function showTheme() {
  const theme = document.documentElement.dataset.theme ?? "system";
  const button = $("#theme-button");
  button.replaceChildren(icon(THEME_ICONS[theme]));
  button.setAttribute("aria-label", `${t("theme")}: ${t(`theme_${theme}`)}`);
  button.title = `${t("theme")}: ${t(`theme_${theme}`)}`;
  return theme;
}

$("#theme-button").addEventListener("click", () => {
  const next = THEMES[(THEMES.indexOf(showTheme()) + 1) % THEMES.length];
  if (next === "system") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = next;
  keep("dousa_theme", next === "system" ? "" : next);
  showTheme();
});
showTheme();
