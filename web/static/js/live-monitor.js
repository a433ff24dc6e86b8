// <live-monitor device="id">: the newest samples of a box, as the acquisition program of 000 ch. 8 shows them.
// The live stream says that there is more; only what is new is fetched, and the view glides on between uploads.

import uPlot from "../vendor/uplot/uplot.mjs";
import { colour } from "./palette.js";
import { decode } from "./signals.js";
import { formatter } from "./time.js";
import { SPEED, t } from "./words.js";

/** @typedef {(number | null)[]} Column */
const KEEP_S = 300, FRAME_MS = 50, HEIGHT = 170, MANY = 20000, GAP_S = 2;
/** Without a word for so long the stream is taken up anew, from its newest end. */
const STALE_S = 600;
const AXES = ["axis-x", "axis-y", "axis-z"];
/** @type {Record<string, string[]>} */
const GROUPS = { f: ["fx", "fy", "fz"], speed: ["speed"], w: ["wx", "wy", "wz"], m: ["mx", "my", "mz"], temp: ["temp"] };

class LiveMonitor extends HTMLElement {
  /** @type {Record<string, Column[]>} times, s, and values of each group */ #data = {};
  /** @type {Record<string, uPlot>} */ #plots = {};
  #window = 30;
  /** How much of the past is here, s. */ #span = 0;
  #newest = 0;
  #arrived = 0;
  #contact = 0;
  #paused = 0;
  #drawn = 0;
  #asking = false;
  #again = false;

  connectedCallback() {
    this.addEventListener("click", (event) => this.#press(event));
    document.addEventListener("scatola:change", (event) => {
      const change = /** @type {CustomEvent} */ (event).detail;
      if (change.device_id !== this.getAttribute("device")) return;
      this.#contact = Date.now();
      void this.#fetch();
    });
    document.addEventListener("visibilitychange", () => { if (!document.hidden) void this.#fetch(); });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      for (const plot of Object.values(this.#plots)) plot.destroy();
      this.#plots = {};
    });
    new ResizeObserver(() => { for (const plot of Object.values(this.#plots)) plot.setSize({ width: plot.root.parentElement?.clientWidth || 300, height: HEIGHT }); }).observe(this);
    void this.#fetch();
    requestAnimationFrame((now) => this.#frame(now));
  }

  async #fetch() {
    if (this.#asking) { this.#again = true; return; }
    this.#asking = true;
    const fresh = this.#window > this.#span || Date.now() / 1000 - this.#newest > STALE_S;
    const query = new URLSearchParams({ columns: String(Object.values(GROUPS).flat()), points: String(MANY) });
    if (fresh) query.set("seconds", String(this.#window));
    else {
      query.set("from", new Date(this.#newest * 1000).toISOString());
      query.set("to", new Date((Math.max(this.#newest, Date.now() / 1000) + STALE_S) * 1000).toISOString());
    }
    try {
      const response = await fetch(`/api/v1/devices/${this.getAttribute("device")}/signals?${query}`);
      if (response.ok) this.#take(await response.arrayBuffer(), fresh);
      this.#say(response.ok ? "" : t("The samples cannot be read."));
    } catch {
      this.#say(t("The service cannot be reached."));
    } finally {
      this.#asking = false;
      if (this.#again) { this.#again = false; void this.#fetch(); }
    }
  }

  /** @param {ArrayBuffer} body @param {boolean} fresh */
  #take(body, fresh) {
    const { header, series } = decode(body);
    const t0 = Date.parse(header.t0) / 1000, since = this.#newest;
    if (fresh) { this.#data = {}; this.#span = this.#window; }
    for (const [group, names] of Object.entries(GROUPS)) {
      const columns = (this.#data[group] ??= [[], ...names.map(() => [])]), times = /** @type {number[]} */ (columns[0]);
      const first = series[names[0] ?? ""];
      if (!first) continue;
      const factor = group === "speed" ? SPEED.perMps : 1;
      first.t.forEach((s, row) => {
        const at = t0 + s, before = times[times.length - 1];
        if (before !== undefined && at <= before + 1e-4) return;
        if (before !== undefined && at - before > GAP_S && first.values[row] === first.values[row]) {
          times.push((at + before) / 2);
          columns.slice(1).forEach((column) => column.push(null));
        }
        times.push(at);
        names.forEach((name, k) => { const v = series[name]?.values[row] ?? NaN; columns[k + 1]?.push(Number.isNaN(v) ? null : v * factor); });
        this.#newest = Math.max(this.#newest, at);
      });
      const old = times.findIndex((at) => at > this.#newest - 1.2 * KEEP_S);
      if (old > 0) for (const column of columns) column.splice(0, old);
      this.#plots[group]?.setData(/** @type {uPlot.AlignedData} */ (columns), false);
    }
    if (this.#newest > since) this.#arrived = performance.now();
    this.#values();
  }

  /** The newest values beside the names of the axes. */
  #values() {
    for (const [group, names] of Object.entries(GROUPS)) names.forEach((name, k) => {
      const place = this.querySelector(`[data-now="${name}"]`);
      if (place) place.textContent = this.#data[group]?.[k + 1]?.at(-1)?.toFixed(2) ?? "";
    });
  }

  /** @param {string} name @param {number} since ms @param {number} digits */
  #age(name, since, digits) {
    const place = this.querySelector(`[data-age="${name}"]`);
    if (place && since) place.textContent = ((Date.now() - since) / 1000).toFixed(digits);
  }

  /** @param {number} now */
  #frame(now) {
    requestAnimationFrame((next) => this.#frame(next));
    // No oftener than the picture moves by a pixel.
    if (now - this.#drawn < Math.max(FRAME_MS, (1000 * this.#window) / this.clientWidth) || !this.#newest) return;
    this.#drawn = now;
    this.#age("sample", this.#newest * 1000, 1);
    this.#age("contact", this.#contact, 0);
    const edge = this.#paused || this.#newest + Math.min((now - this.#arrived) / 1000, this.#window / 2);
    for (const group of Object.keys(GROUPS)) {
      const host = this.querySelector(`[data-group="${group}"]`);
      if (host instanceof HTMLElement && !host.hidden) (this.#plots[group] ??= this.#plot(group, host)).setScale("x", { min: edge - this.#window, max: edge });
    }
  }

  /** @param {string} group @param {HTMLElement} host */
  #plot(group, host) {
    const place = /** @type {HTMLElement} */ (host.querySelector(".plot")), names = GROUPS[group] ?? [];
    const axis = { stroke: colour("muted"), grid: { stroke: colour("line"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif" };
    const clock = formatter({ hour: "2-digit", minute: "2-digit", second: "2-digit" });
    /** @type {uPlot.Options} */
    const options = {
      width: place.clientWidth, height: HEIGHT, legend: { show: false }, cursor: { show: false },
      scales: { x: { auto: false }, y: { range: (_, low, high) => (low === null ? [0, 1] : [low - 0.1 * (high - low) - 0.5, high + 0.1 * (high - low) + 0.5]) } },
      axes: [{ ...axis, space: 90, size: 30, values: (_, ticks) => ticks.map((s) => clock.format(s * 1000)) }, { ...axis, size: 48 }],
      series: [{}, ...names.map((_, k) => ({ stroke: colour(names.length > 1 ? AXES[k] ?? "track" : "track"), width: 1.2, points: { show: false } }))],
    };
    return new uPlot(options, /** @type {uPlot.AlignedData} */ (this.#data[group] ?? [[]]), place);
  }

  /** @param {Event} event */
  #press(event) {
    const button = event.target instanceof Element ? event.target.closest("button") : null;
    if (!button) return;
    const choice = button.parentElement?.dataset.choice, on = button.getAttribute("aria-pressed") !== "true";
    if (choice === "window") {
      this.#window = Number(button.value);
      for (const one of button.parentElement?.children ?? []) one.setAttribute("aria-pressed", String(one === button));
      return void this.#fetch();
    }
    button.setAttribute("aria-pressed", String(on));
    if (choice === "more") this.querySelector(`[data-group="${button.value}"]`)?.toggleAttribute("hidden", !on);
    else this.#paused = on ? this.#newest : 0;
  }

  /** @param {string} words */
  #say(words) {
    const line = this.querySelector(".chart-words");
    if (line) line.textContent = words;
  }
}

customElements.define("live-monitor", LiveMonitor);
