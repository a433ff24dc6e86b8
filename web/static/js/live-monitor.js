// <live-monitor device="id">: the newest samples of a box, as the acquisition program of 000 ch. 8 shows them.
// The stream says that there is more; only what is new is fetched, and the view glides on between uploads.

import { Charts } from "./charts.js";
import { colour, hear } from "./page.js";
import { fetchSignals, iso } from "./signals.js";

const KEEP_S = 360, STALE_S = 600, GAP_S = 2;
/** @type {Record<string, string[]>} */
const GROUPS = { f: ["fx", "fy", "fz"], speed: ["speed"], w: ["wx", "wy", "wz"], m: ["mx", "my", "mz"], temp: ["temp"] };

class LiveMonitor extends Charts {
  /** @type {Record<string, Column[]>} */ #data = {};
  /** Seconds in view, and of the past that is here. */ #window = 30; #span = 0;
  /** Times in s. */ #newest = 0; #arrived = 0; #contact = 0; #paused = 0; #drawn = 0;
  #asking = false; #again = false;

  connectedCallback() {
    this.onPress((button, choice) => {
      const on = button.ariaPressed !== "true";
      button.ariaPressed = String(on);
      if (choice === "window") {
        this.press(choice, this.#window = Number(button.value));
        void this.#ask();
      } else if (choice) this.querySelector(`[data-group="${button.value}"]`)?.toggleAttribute("hidden", !on);
      else this.#paused = on ? this.#newest : 0;
    });
    hear("change", ({ device_id: id }) => {
      if (id !== this.getAttribute("device")) return;
      this.#contact = Date.now() / 1000;
      void this.#ask();
    });
    this.keepUp(() => {});
    void this.#ask();
    requestAnimationFrame(this.#frame);
  }

  async #ask() {
    this.#again = true;
    if (this.#asking) return;
    for (this.#asking = true; this.#again;) {
      this.#again = false;
      this.say(await this.#fetch().catch(({ message }) => message) ?? "");
    }
    this.#asking = false;
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
        if (at - last > GAP_S && last > 0) columns.forEach((column, k) => column.push(k ? null : (at + last) / 2));
        columns.forEach((column, k) => column.push(k ? series[names[k - 1] ?? ""]?.values[row] ?? null : at));
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
    for (const [group, names] of Object.entries(GROUPS)) {
      if (this.querySelector(`[data-group="${group}"]`)?.hasAttribute("hidden")) continue;
      const lines = names.map((name) => ({ stroke: colour(names.length > 1 ? `axis-${name[1]}` : "track") }));
      const plot = this.plots[group] ?? this.plot(group, { lines, cursor: { show: false } }, this.#data[group] ?? [[]]);
      plot.setScale("x", { min: max - this.#window, max });
    }
  };
}

customElements.define("live-monitor", LiveMonitor);
