// Times come from the server in UTC and are shown in the reader's zone, or in UTC at the press of a button.

import { tell } from "./page.js";
import { LANGUAGE } from "./words.js";

const KEY = "scatola:utc";
const MINUTE_S = 60, HOUR_S = 3600, DAY_S = 86400;
let utc = localStorage.getItem(KEY) === "1";

/** @type {Formatter} */
export const formatter = (style) => new Intl.DateTimeFormat(LANGUAGE, { ...style, ...(utc && { timeZone: "UTC" }) });

const DATE = /** @type {const} */ ({ day: "2-digit", month: "short" });
const CLOCK = /** @type {const} */ ({ ...DATE, hour: "2-digit", minute: "2-digit" });

const since = new Intl.RelativeTimeFormat(LANGUAGE, { numeric: "auto", style: "short" });

/** @param {Date} at @param {Intl.DateTimeFormat} day */
function ago(at, day) {
  const s = Math.max(Math.round((Date.now() - at.getTime()) / 1000), 0);
  if (s < MINUTE_S) return since.format((s % 5) - s, "second");
  if (s < HOUR_S) return since.format(-Math.floor(s / MINUTE_S), "minute");
  return s < DAY_S ? since.format(-Math.floor(s / HOUR_S), "hour") : day.format(at);
}

/** Words for every time element below a root. @param {ParentNode} root */
export function formatTimes(root = document) {
  const day = formatter({ ...DATE, year: "numeric" });
  const short = formatter(CLOCK), full = formatter({ ...CLOCK, year: "numeric", second: "2-digit" });
  for (const element of root.querySelectorAll("time")) {
    const at = new Date(element.dateTime), { style } = element.dataset;
    const words = style === "ago" ? ago(at, day) : (style === "short" ? short : full).format(at);
    if (element.textContent !== words) element.textContent = words;
    element.title = `${full.format(at)} (${at.toISOString().slice(0, 19)}Z)`;
  }
}

function show() {
  const zone = document.querySelector("#zone span");
  if (zone) zone.textContent = utc ? "UTC" : Intl.DateTimeFormat().resolvedOptions().timeZone;
  formatTimes();
}

export function changeZone() {
  utc = !utc;
  localStorage.setItem(KEY, utc ? "1" : "");
  show();
  tell("zone", null);
}

export function showTimes() {
  show();
  document.getElementById("zone")?.addEventListener("click", changeZone);
  setInterval(formatTimes, 5000);
}
