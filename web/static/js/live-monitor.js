// <live-monitor device="id">: the newest samples of a box, as the acquisition program of 000 ch. 8 shows them.
// The stream says that there is more; only what is new is fetched, and the view glides on between uploads.

import { Charts } from "./charts.js";
import { pressedButton } from "./page.js";
import { colour } from "./palette.js";
import { fetchSignals, iso } from "./signals.js";
import { SPEED } from "./words.js";

const KEEP_S = 360, STALE_S = 600, GAP_S = 2;
/** @type {Record<string, string[]>} */
const GROUPS = { f: ["fx", "fy", "fz"], speed: ["speed"], w: ["wx", "wy", "wz"], m: ["mx", "my", "mz"], temp: ["temp"] };

class LiveMonitor extends Charts {
  /** @type {Record<string, Column[]>} */ #data = {};
  /** Seconds in view, and of the past that is here. */ #window = 30; #span = 0;
  /** Times in s. */ #newest = 0; #arrived = 0; #contact = 0; #paused = 0; #drawn = 0;
  /** @type {Promise<void> | undefined} */ #asking;
  #again = false;

  connectedCallback() {
    this.addEventListener("click", (event) => this.#press(event));
    document.addEventListener("scatola:change", ({ detail }) => {
      if (detail.device_id !== this.getAttribute("device")) return;
      this.#contact = Date.now() / 1000;
      this.#ask();
    });
    this.keepUp(() => {});
    this.#ask();
    requestAnimationFrame(this.#frame);
  }

  #ask() {
    this.#again = !!this.#asking;
    this.#asking ??= this.#fetch().then(() => "", (/** @type {Error} */ problem) => problem.message).then((words) => {
      this.say(words);
      this.#asking = undefined;
      if (this.#again) this.#ask();
    });
  }

  async #fetch() {
    const now = Date.now() / 1000, fresh = this.#window > this.#span || now - this.#newest > STALE_S, span = this.#window;
    const place = fresh ? { seconds: span } : { from: iso(this.#newest), to: iso(Math.max(this.#newest, now) + STALE_S) };
    const { series } = await fetchSignals(this.getAttribute("device"), { points: 20000, columns: Object.values(GROUPS).join(), ...place });
    const before = this.#newest;
    if (fresh) { this.#data = {}; this.#span = span; }
    for (const [group, names] of Object.entries(GROUPS)) {
      const columns = (this.#data[group] ??= [[], ...names.map(() => [])]), times = columns[0] ?? [];
      series[names[0] ?? ""]?.t.forEach((at, row) => {
        const last = times.at(-1) ?? -Infinity;
        if (at < last + 1e-4) return;
        const values = names.map((name) => series[name]?.values[row] ?? NaN);
        if (at - last > GAP_S && last > 0) columns.forEach((column, k) => column.push(k ? null : (at + last) / 2));
        columns.forEach((column, k) => { const v = values[k - 1] ?? at; column.push(Number.isNaN(v) ? null : group === "speed" && k ? v * SPEED.perMps : v); });
        this.#newest = Math.max(this.#newest, at);
      });
      const old = times.findIndex((at) => (at ?? 0) > this.#newest - KEEP_S);
      columns.forEach((column) => column.splice(0, Math.max(old, 0)));
      this.plots[group]?.setData(/** @type {PlotData} */ (columns), false);
      names.forEach((name, k) => this.put("now", name, columns[k + 1]?.at(-1), 2));
    }
    if (this.#newest > before) this.#arrived = performance.now();
  }

  #frame = (/** @type {number} */ now) => {
    requestAnimationFrame(this.#frame);
    // No oftener than the picture moves by a pixel.
    if (now - this.#drawn < Math.max(50, (1000 * this.#window) / this.clientWidth) || !this.#newest) return;
    this.#drawn = now;
    this.put("age", "sample", Date.now() / 1000 - this.#newest, 1);
    if (this.#contact) this.put("age", "contact", Date.now() / 1000 - this.#contact, 0);
    const max = this.#paused || this.#newest + Math.min((now - this.#arrived) / 1000, this.#window / 2);
    for (const group of Object.keys(GROUPS)) {
      if (!this.#part(group)?.hasAttribute("hidden")) (this.plots[group] ?? this.#plot(group)).setScale("x", { min: max - this.#window, max });
    }
  };

  /** @param {string} group */
  #part(group) { return this.querySelector(`[data-group="${group}"]`); }

  /** @param {string} group */
  #plot(group) {
    const names = GROUPS[group] ?? [];
    return this.plot(group, {
      lines: names.map((name) => ({ stroke: colour(names.length > 1 ? `axis-${name[1]}` : "track"), width: 1.2 })), cursor: { show: false },
      scales: { x: { auto: false }, y: { range } },
    }, this.#data[group] ?? [[]]);
  }

  /** @param {Event} event */
  #press(event) {
    const button = pressedButton(event);
    if (!button) return;
    const choice = button.parentElement?.dataset.choice, on = button.ariaPressed !== "true";
    button.ariaPressed = String(on);
    if (choice === "window") {
      this.#window = Number(button.value);
      for (const one of button.parentElement?.children ?? []) one.ariaPressed = String(one === button);
      this.#ask();
    } else if (choice) this.#part(button.value)?.toggleAttribute("hidden", !on);
    else this.#paused = on ? this.#newest : 0;
  }
}

/** @type {ValueRange} */
function range(_, low, high) {
  const room = 0.1 * (high - low) + 0.5;
  return [low - room, high + room];
}

customElements.define("live-monitor", LiveMonitor);
