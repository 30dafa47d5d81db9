"use strict";
/* The button for a light or dark page; without it, or on "auto", the page is as the system asks. */
{
  const themes = ["auto", "light", "dark"],
    button = document.getElementById("theme");
  let theme = 0;
  button.hidden = false;
  button.addEventListener("click", () => {
    theme = (theme + 1) % 3;
    document.getElementById("theme-name").textContent = themes[theme];
    if (theme) document.documentElement.dataset.theme = themes[theme];
    else delete document.documentElement.dataset.theme;
  });
}
