// Light or dark.
(() => {
  const root = document.documentElement;
  const button = document.getElementById("theme");
  const wantsDark = window.matchMedia("(prefers-color-scheme: dark)");
  const isDark = () => (root.dataset.theme ? root.dataset.theme === "dark" : wantsDark.matches);

  function show(theme) {
    if (theme === "dark" || theme === "light") root.dataset.theme = theme;
    button.textContent = isDark() ? "Light" : "Dark";
    button.setAttribute("aria-label", isDark() ? "Use light colours" : "Use dark colours");
    document.dispatchEvent(new Event("themechange"));
  }
  function kept(...theme) {
    try {
      if (theme.length) localStorage.setItem("gendom-theme", ...theme);
      return localStorage.getItem("gendom-theme");
    } catch {
      return theme[0]; // files that are opened from a disk may have no storage
    }
  }
  button.addEventListener("click", () => show(kept(isDark() ? "light" : "dark")));
  wantsDark.addEventListener("change", show);
  window.addEventListener("beforeprint", () => {
    for (const folded of document.querySelectorAll("details")) folded.open = true;
  });
  button.hidden = false;
  show(kept());
})();
