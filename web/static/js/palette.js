/** Colour of a CSS variable in the reader's scheme. @param {string} name */
export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

/** Run when the reader changes between light and dark. @param {() => void} run */
export function onScheme(run) {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", run);
}
