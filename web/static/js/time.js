// Times come from the server in UTC and are shown in the reader's zone, which the top bar names.

const DATE_TIME = new Intl.DateTimeFormat("en-GB", { day: "2-digit", month: "short", year: "numeric", hour: "2-digit", minute: "2-digit", second: "2-digit" });
const SHORT = new Intl.DateTimeFormat("en-GB", { day: "2-digit", month: "short", hour: "2-digit", minute: "2-digit" });
const DAY = new Intl.DateTimeFormat("en-GB", { day: "2-digit", month: "short", year: "numeric" });
const MINUTE_S = 60, HOUR_S = 3600, DAY_S = 86400;

/** @param {Date} at @param {number} now milliseconds */
function ago(at, now) {
  const seconds = Math.round((now - at.getTime()) / 1000);
  if (seconds < 5) return "now";
  if (seconds < MINUTE_S) return `${seconds - (seconds % 5)} s ago`;
  if (seconds < HOUR_S) return `${Math.floor(seconds / MINUTE_S)} min ago`;
  if (seconds < DAY_S) return `${Math.floor(seconds / HOUR_S)} h ago`;
  return DAY.format(at);
}

/** Words for every time element below a root. @param {ParentNode} root */
export function formatTimes(root = document) {
  const now = Date.now();
  for (const element of root.querySelectorAll("time[datetime]")) {
    if (!(element instanceof HTMLTimeElement)) continue;
    const at = new Date(element.dateTime);
    const style = element.dataset.style;
    const words = style === "ago" ? ago(at, now) : (style === "short" ? SHORT : DATE_TIME).format(at);
    if (element.textContent !== words) element.textContent = words;
    element.title = `${DATE_TIME.format(at)} (${at.toISOString().slice(0, 19)}Z)`;
  }
}

export function showTimes() {
  const zone = document.getElementById("zone");
  if (zone) zone.textContent = Intl.DateTimeFormat().resolvedOptions().timeZone;
  formatTimes();
  setInterval(formatTimes, 5000);
}
