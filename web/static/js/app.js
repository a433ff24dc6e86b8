// Every page: times in the reader's zone, live updates, copy buttons, links that change the list in place, keys.

import { go, watch } from "./live.js";
import { changeZone, showTimes } from "./time.js";
import { t } from "./words.js";

showTimes();
watch();

/** Close the open menu, if any. @param {Element | null} [but] unless this is in it */
function closeMenu(but = null) {
  const open = document.querySelector("details.menu[open], .rail-more[open]");
  if (!open || open.contains(but)) return;
  // Who was inside goes on from its button.
  if (open.contains(document.activeElement)) open.querySelector("summary")?.focus();
  open.removeAttribute("open");
}

document.addEventListener("click", (event) => {
  const target = event.target instanceof Element ? event.target : null;
  const link = target?.closest("a[data-soft]");
  if (link instanceof HTMLAnchorElement && !event.ctrlKey && !event.metaKey && !event.shiftKey) {
    event.preventDefault();
    void go(link.href);
  }
  closeMenu(target);
  const button = target?.closest("[data-copy]"), words = button?.querySelector("span");
  if (!button || !words) return;
  const before = words.textContent;
  void navigator.clipboard.writeText(button.getAttribute("data-copy") ?? "").then(() => {
    words.textContent = t("copied");
    setTimeout(() => { words.textContent = before; }, 1500);
  });
});

/** The row before or after the one that has the focus. @param {1 | -1} step */
function move(step) {
  const links = [...document.querySelectorAll(".rows tbody th a")].filter((a) => a.checkVisibility());
  const next = links[links.indexOf(/** @type {Element} */ (document.activeElement)) + step] ?? links.at(step > 0 ? 0 : -1);
  if (next instanceof HTMLElement) next.focus();
}

/** @type {Record<string, () => void>} */
const KEYS = {
  "/": () => document.getElementById("search")?.focus(),
  "?": () => document.querySelector("dialog")?.showModal(),
  j: () => move(1),
  k: () => move(-1),
  z: changeZone,
};

document.addEventListener("keydown", (event) => {
  if (event.key === "Escape") closeMenu();
  const run = KEYS[event.key];
  if (!run || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.target instanceof Element && event.target.closest("input, select, textarea, dialog, [contenteditable]")) return;
  event.preventDefault();
  run();
});
