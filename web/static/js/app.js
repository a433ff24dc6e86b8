// Every page: times in the reader's zone, live updates, copy buttons.

import { watch } from "./live.js";
import { showTimes } from "./time.js";

showTimes();
watch();

document.addEventListener("click", (event) => {
  const button = event.target instanceof Element ? event.target.closest("[data-copy]") : null;
  if (!(button instanceof HTMLElement) || !button.dataset.copy) return;
  const words = button.querySelector("span");
  const before = words?.textContent ?? "";
  void navigator.clipboard.writeText(button.dataset.copy).then(() => {
    if (!words) return;
    words.textContent = "copied";
    setTimeout(() => { words.textContent = before; }, 1500);
  });
});
