// Times come from the server in UTC and are shown in the reader's zone, or in UTC at the press of a button.

import { LANGUAGE } from "./words.js";

const KEY = "scatola:utc";
const MINUTE_S = 60, HOUR_S = 3600, DAY_S = 86400;
let utc = localStorage.getItem(KEY) === "1";

/** @param {Intl.DateTimeFormatOptions} style */
export function formatter(style) {
  return new Intl.DateTimeFormat(LANGUAGE, { ...style, ...(utc && { timeZone: "UTC" }) });
}

const DATE = /** @type {const} */ ({ day: "2-digit", month: "short" });
const CLOCK = /** @type {const} */ ({ ...DATE, hour: "2-digit", minute: "2-digit" });

const since = new Intl.RelativeTimeFormat(LANGUAGE, { numeric: "auto", style: "short" });

/** @param {Date} at @param {number} now milliseconds @param {Intl.DateTimeFormat} day */
function ago(at, now, day) {
  const s = Math.max(Math.round((now - at.getTime()) / 1000), 0);
  if (s < MINUTE_S) return since.format((s % 5) - s, "second");
  if (s < HOUR_S) return since.format(-Math.floor(s / MINUTE_S), "minute");
  return s < DAY_S ? since.format(-Math.floor(s / HOUR_S), "hour") : day.format(at);
}

/** Words for every time element below a root. @param {ParentNode} root */
export function formatTimes(root = document) {
  const now = Date.now(), day = formatter({ ...DATE, year: "numeric" });
  const short = formatter(CLOCK), full = formatter({ ...CLOCK, year: "numeric", second: "2-digit" });
  for (const element of root.querySelectorAll("time")) {
    const at = new Date(element.dateTime);
    const style = element.dataset.style;
    const words = style === "ago" ? ago(at, now, day) : (style === "short" ? short : full).format(at);
    if (element.textContent !== words) element.textContent = words;
    const title = `${full.format(at)} (${at.toISOString().slice(0, 19)}Z)`;
    if (element.title !== title) element.title = title;
  }
}

function sayZone() {
  const zone = document.querySelector("#zone span");
  if (zone) zone.textContent = utc ? "UTC" : Intl.DateTimeFormat().resolvedOptions().timeZone;
}

export function changeZone() {
  utc = !utc;
  localStorage.setItem(KEY, utc ? "1" : "");
  sayZone();
  formatTimes();
  document.dispatchEvent(new CustomEvent("scatola:zone"));
}

export function showTimes() {
  sayZone();
  document.getElementById("zone")?.addEventListener("click", changeZone);
  formatTimes();
  setInterval(formatTimes, 5000);
}
