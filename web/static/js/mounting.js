// The mounting in 3D: the slider walks through the history; page and picture show the same step.

import { go } from "./live.js";
import { hear, told } from "./page.js";
import "./scene-3d.js";

const slider = /** @type {HTMLInputElement} */ (document.getElementById("step"));
const ghost = /** @type {HTMLInputElement} */ (document.getElementById("before"));
/** @type {Timer} */ let pending;

/** The step under the slider; none for the newest, which goes on with the data. */
function show() {
  const step = told("moment").steps?.split(" ").slice(0, -1)[Number(slider.value)];
  document.querySelector("scene-3d")?.show({ step: step ?? null, before: ghost.checked });
  return new URLSearchParams({ ...(step && { step }), ...(ghost.checked && { before: "true" }) });
}

function changed() {
  const query = show();
  clearTimeout(pending);
  pending = setTimeout(() => void go(`${location.pathname}?${query}`, false), 120);
}

/** The page was renewed, by its data or by a link. */
function follow() {
  const { steps = "", shown = "", words = "" } = told("moment");
  slider.max = String(steps.split(" ").length - 1);
  slider.value = shown;
  slider.ariaValueText = words;
  show();
}

slider.addEventListener("input", changed);
ghost.addEventListener("change", changed);
hear("parts", follow);
follow();
