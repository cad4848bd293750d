// Light or dark, and which part of the page the contents mark.
(() => {
  const root = document.documentElement;
  const button = document.getElementById("theme");
  const wantsDark = window.matchMedia("(prefers-color-scheme: dark)");
  const isDark = () => (root.dataset.theme ? root.dataset.theme === "dark" : wantsDark.matches);

  function show() {
    button.textContent = isDark() ? "Light" : "Dark";
    button.setAttribute("aria-label", isDark() ? "Use light colours" : "Use dark colours");
    document.dispatchEvent(new Event("themechange"));
  }
  try {
    const kept = localStorage.getItem("gendom-theme");
    if (kept === "dark" || kept === "light") root.dataset.theme = kept;
  } catch {
    // files that are opened from a disk may have no storage
  }
  button.addEventListener("click", () => {
    root.dataset.theme = isDark() ? "light" : "dark";
    try {
      localStorage.setItem("gendom-theme", root.dataset.theme);
    } catch {
      // as above: the choice then lasts until the page is closed
    }
    show();
  });
  wantsDark.addEventListener("change", show);
  window.addEventListener("beforeprint", () => {
    for (const folded of document.querySelectorAll("details")) folded.open = true;
  });
  button.hidden = false;
  show();

  const links = new Map();
  for (const link of document.querySelectorAll("nav.contents a")) {
    links.set(document.getElementById(link.hash.slice(1)), link);
  }
  function mark() {
    let current = null;
    for (const [section, link] of links) {
      if (current === null || section.getBoundingClientRect().top < 0.35 * innerHeight) {
        current = link;
      }
    }
    for (const link of links.values()) {
      if (link === current) link.setAttribute("aria-current", "true");
      else link.removeAttribute("aria-current");
    }
  }
  addEventListener("scroll", mark, { passive: true });
  mark();
})();
