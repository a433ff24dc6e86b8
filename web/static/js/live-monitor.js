// <live-monitor device="id">: the newest samples of a box, as the acquisition program of 000 ch. 8 shows them.
// The stream says that there is more; only what is new is fetched, and the view glides on between uploads.

import uPlot from "../vendor/uplot/uplot.mjs";
import { chartAxis, colour } from "./palette.js";
import { decode } from "./signals.js";
import { formatter } from "./time.js";
import { SPEED, t } from "./words.js";

const KEEP_S = 360, STALE_S = 600, GAP_S = 2, HEIGHT = 170;
/** @type {Record<string, string[]>} */
const GROUPS = { f: ["fx", "fy", "fz"], speed: ["speed"], w: ["wx", "wy", "wz"], m: ["mx", "my", "mz"], temp: ["temp"] };

class LiveMonitor extends HTMLElement {
  /** @type {Record<string, Column[]>} */ #data = {};
  /** @type {Record<string, uPlot>} */ #plots = {};
  /** Seconds in view, and of the past that is here. */ #window = 30; #span = 0;
  /** Times in s. */ #newest = 0; #arrived = 0; #contact = 0; #paused = 0; #drawn = 0;
  /** @type {Promise<void> | undefined} */ #asking;
  #again = false;

  connectedCallback() {
    this.addEventListener("click", (event) => this.#press(event));
    document.addEventListener("scatola:change", (event) => {
      if (/** @type {CustomEvent<Change>} */ (event).detail.device_id !== this.getAttribute("device")) return;
      this.#contact = Date.now() / 1000;
      this.#ask();
    });
    new ResizeObserver(() => this.#discard()).observe(this);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.#discard());
    this.#ask();
    requestAnimationFrame(this.#frame);
  }

  #ask() {
    this.#again = !!this.#asking;
    this.#asking ??= this.#fetch().catch(() => t("The service cannot be reached.")).then((words) => {
      const line = this.querySelector(".chart-words");
      if (line) line.textContent = words;
      this.#asking = undefined;
      if (this.#again) this.#ask();
    });
  }

  async #fetch() {
    const now = Date.now() / 1000, fresh = this.#window > this.#span || now - this.#newest > STALE_S, span = this.#window;
    const iso = (/** @type {number} */ s) => new Date(s * 1000).toISOString();
    const place = fresh ? `seconds=${span}` : `from=${iso(this.#newest)}&to=${iso(Math.max(this.#newest, now) + STALE_S)}`;
    const response = await fetch(`/api/v1/devices/${this.getAttribute("device")}/signals?points=20000&${place}&columns=${Object.values(GROUPS)}`);
    if (!response.ok) return t("The samples cannot be read.");
    const { header, series } = decode(await response.arrayBuffer()), t0 = Date.parse(header.t0) / 1000, before = this.#newest;
    if (fresh) { this.#data = {}; this.#span = span; }
    for (const [group, names] of Object.entries(GROUPS)) {
      const columns = (this.#data[group] ??= [[], ...names.map(() => [])]), times = columns[0] ?? [];
      series[names[0] ?? ""]?.t.forEach((s, row) => {
        const at = t0 + s, last = times.at(-1) ?? -Infinity;
        if (at < last + 1e-4) return;
        const values = names.map((name) => series[name]?.values[row] ?? NaN);
        if (at - last > GAP_S && last > 0) columns.forEach((column, k) => column.push(k ? null : (at + last) / 2));
        columns.forEach((column, k) => { const v = values[k - 1] ?? at; column.push(Number.isNaN(v) ? null : group === "speed" && k ? v * SPEED.perMps : v); });
        this.#newest = Math.max(this.#newest, at);
      });
      const old = times.findIndex((at) => (at ?? 0) > this.#newest - KEEP_S);
      columns.forEach((column) => column.splice(0, Math.max(old, 0)));
      this.#plots[group]?.setData(/** @type {uPlot.AlignedData} */ (columns), false);
      names.forEach((name, k) => this.#say("now", name, columns[k + 1]?.at(-1), 2));
    }
    if (this.#newest > before) this.#arrived = performance.now();
    return "";
  }

  /** @param {string} kind @param {string} name @param {number | null | undefined} value @param {number} digits */
  #say(kind, name, value, digits) {
    const place = this.querySelector(`[data-${kind}="${name}"]`);
    if (place) place.textContent = value?.toFixed(digits) ?? "–";
  }

  #frame = (/** @type {number} */ now) => {
    requestAnimationFrame(this.#frame);
    // No oftener than the picture moves by a pixel.
    if (now - this.#drawn < Math.max(50, (1000 * this.#window) / this.clientWidth) || !this.#newest) return;
    this.#drawn = now;
    this.#say("age", "sample", Date.now() / 1000 - this.#newest, 1);
    if (this.#contact) this.#say("age", "contact", Date.now() / 1000 - this.#contact, 0);
    const max = this.#paused || this.#newest + Math.min((now - this.#arrived) / 1000, this.#window / 2);
    for (const group of Object.keys(GROUPS)) {
      const host = this.querySelector(`[data-group="${group}"]:not([hidden]) .plot`);
      if (host instanceof HTMLElement) (this.#plots[group] ??= this.#plot(group, host)).setScale("x", { min: max - this.#window, max });
    }
  };

  /** @param {string} group @param {HTMLElement} host */
  #plot(group, host) {
    const names = GROUPS[group] ?? [], clock = formatter({ hour: "2-digit", minute: "2-digit", second: "2-digit" });
    return new uPlot({
      width: host.clientWidth, height: HEIGHT, legend: { show: false }, cursor: { show: false },
      scales: { x: { auto: false }, y: { range: (_, low, high) => { const room = 0.1 * (high - low) + 0.5; return [(low ?? 0) - room, (high ?? 0) + room]; } } },
      axes: [{ ...chartAxis(), space: 90, size: 30, values: (_, ticks) => ticks.map((s) => clock.format(s * 1000)) }, { ...chartAxis(), size: 48 }],
      series: [{}, ...names.map((name) => ({ stroke: colour(names.length > 1 ? `axis-${name[1]}` : "track"), width: 1.2, points: { show: false } }))],
    }, /** @type {uPlot.AlignedData} */ (this.#data[group] ?? [[]]), host);
  }

  #discard() {
    Object.values(this.#plots).forEach((plot) => plot.destroy());
    this.#plots = {};
  }

  /** @param {Event} event */
  #press(event) {
    const button = event.target instanceof Element ? event.target.closest("button") : null;
    if (!button) return;
    const choice = button.parentElement?.dataset.choice, on = button.ariaPressed !== "true";
    button.ariaPressed = String(on);
    if (choice === "window") {
      this.#window = Number(button.value);
      for (const one of button.parentElement?.children ?? []) one.ariaPressed = String(one === button);
      this.#ask();
    } else if (choice) this.querySelector(`[data-group="${button.value}"]`)?.toggleAttribute("hidden", !on);
    else this.#paused = on ? this.#newest : 0;
  }
}

customElements.define("live-monitor", LiveMonitor);
