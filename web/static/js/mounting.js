// The mounting in 3D: the slider walks through the history; page and picture show the same step.

import { go } from "./live.js";
import { Scene3d } from "./scene-3d.js";

const slider = /** @type {HTMLInputElement | null} */ (document.getElementById("step"));
const ghost = /** @type {HTMLInputElement | null} */ (document.getElementById("before"));
/** @type {ReturnType<typeof setTimeout> | undefined} */
let pending;

/** Steps as the page last had them: its moment tells. */
function steps() {
  return document.getElementById("moment")?.dataset.steps?.split(" ") ?? [];
}

/** @param {string | undefined} step none for the newest, which goes on with the data */
function show(step) {
  const scene = document.querySelector("scene-3d");
  if (scene instanceof Scene3d) scene.show({ step: step ?? null, before: ghost?.checked ?? false });
}

function chosen() {
  const all = steps();
  const at = Number(slider?.value ?? all.length - 1);
  return at < all.length - 1 ? all[at] : undefined;
}

function changed() {
  const step = chosen();
  show(step);
  clearTimeout(pending);
  const query = new URLSearchParams({ ...(step && { step }), ...(ghost?.checked && { before: "true" }) });
  pending = setTimeout(() => void go(`${location.pathname}?${query}`, false), 120);
}

/** The page was renewed, by its data or by a link. */
function follow() {
  const moment = document.getElementById("moment");
  if (slider && moment) {
    slider.max = String(Math.max(steps().length - 1, 0));
    slider.value = moment.dataset.shown ?? slider.max;
    slider.setAttribute("aria-valuetext", moment.dataset.words ?? "");
  }
  show(chosen());
}

slider?.addEventListener("input", changed);
ghost?.addEventListener("change", changed);
document.addEventListener("scatola:parts", follow);
void customElements.whenDefined("scene-3d").then(follow);
