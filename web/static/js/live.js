// The page stays true without a reload.  The server says *that* something changed (server-sent
// events, resumed by Last-Event-ID); the page then fetches itself and swaps the parts marked
// data-live, so there is one way a number gets on the screen.

import { tell } from "./page.js";
import { formatTimes } from "./time.js";
import { t } from "./words.js";

const KINDS = ["batch", "installation", "trip", "position", "moved", "device", "vehicle", "event", "alert", "analysis"];
/** Changes come in crowds; a second's worth of them is one fetch, and a page that takes long to make waits longer. */
const SETTLE_MS = 1000;
const REST_PER_WORK = 8;
/** Nobody who waits for a crash report waits for the crowd. */
const URGENT_MS = 100;
const RETRY_MS = 5000;

/** @type {Timer} */ let pending;
let stale = false;
/** Not before: a large fleet changes all the time, and its page is not made all the time. */
let restUntil = 0;

export function watch() {
  connect();
  document.addEventListener("visibilitychange", () => { if (!document.hidden && stale) refreshSoon(); });
  addEventListener("popstate", () => void refresh());
  addEventListener("pageshow", (event) => { if (event.persisted) location.reload(); });
}

function connect() {
  // The page says up to which change it is true; a connection that drops resumes by Last-Event-ID.
  const source = new EventSource(`/api/v1/live?after=${document.body.dataset.change ?? ""}`);
  source.addEventListener("open", () => say("on", t("Live")));
  source.addEventListener("error", () => {
    say("off", t("Reconnecting"));
    if (source.readyState !== EventSource.CLOSED) return;
    // Refused rather than dropped, and the browser will not try again by itself: signed out, or not up yet.
    setTimeout(() => { void refresh(); connect(); }, RETRY_MS);
  });
  for (const kind of KINDS) {
    source.addEventListener(kind, (event) => {
      /** @type {Change} */
      const change = { kind, ...JSON.parse(event.data) };
      tell("change", change);
      if (concerns(change)) refreshSoon(kind === "event" || kind === "alert" ? URGENT_MS : SETTLE_MS);
    });
  }
  addEventListener("pagehide", () => source.close());
}

/** Whether the page is about what changed; a page without a subject is about everything. @param {Change} change */
function concerns({ kind, device_id: device, vehicle_id: vehicle }) {
  const about = document.body.dataset.about?.split(" ").filter(Boolean) ?? [];
  if (kind === "analysis") return about.includes(kind);
  return !about[0] || about.some((id) => id === device || id === vehicle);
}

/** @param {"on" | "off"} state @param {string} words */
function say(state, words) {
  const sign = document.getElementById("live"), text = document.getElementById("live-words");
  if (sign && text) { sign.dataset.state = state; text.textContent = words; }
}

/** When the waiting refresh is due. */
let dueAt = Infinity;

/** @param {number} within milliseconds */
function refreshSoon(within = SETTLE_MS) {
  stale = true;
  const at = Math.max(performance.now() + within, within === URGENT_MS ? 0 : restUntil);
  if (document.hidden || dueAt <= at) return;
  clearTimeout(pending);
  dueAt = at;
  pending = setTimeout(refresh, at - performance.now());
}

/** Another address of the same page: its parts are swapped, and the address can be kept and sent. @param {string} address */
export async function go(address, back = true) {
  history[back ? "pushState" : "replaceState"](null, "", address);
  await refresh();
}

async function refresh() {
  stale = false;
  const began = performance.now();
  try {
    const response = await fetch(location.href, { headers: { Accept: "text/html" } });
    if (response.redirected) { location.reload(); return; }  // signed out meanwhile
    if (response.ok) swap(new DOMParser().parseFromString(await response.text(), "text/html"));
  } catch {
    say("off", t("Reconnecting"));
  } finally {
    dueAt = Infinity;
    restUntil = performance.now() + REST_PER_WORK * (performance.now() - began);
    if (stale) refreshSoon();
  }
}

/** @type {WeakMap<Element, string | undefined>} What the server last sent for a part: the times in it were rewritten since. */
const sent = new WeakMap();

/** @param {Document} fresh */
function swap(fresh) {
  for (const part of document.querySelectorAll("[data-live]")) {
    const next = fresh.getElementById(part.id), html = next?.outerHTML;
    // Nobody loses what is being typed.
    if (!next || sent.get(part) === html || part.querySelector(".menu[open], input:focus")) continue;
    const focused = part.querySelector("a:focus")?.getAttribute("href");
    const adopted = document.adoptNode(next);
    formatTimes(adopted);
    part.querySelectorAll("details").forEach(({ open }, k) => adopted.querySelectorAll("details")[k]?.toggleAttribute("open", open));
    part.replaceWith(adopted);
    sent.set(adopted, html);
    if (focused) [...adopted.querySelectorAll("a")].find((a) => a.getAttribute("href") === focused)?.focus({ preventScroll: true });
  }
  tell("parts", null);
}
