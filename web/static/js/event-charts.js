// <event-charts document="url">: delta-V with its band, the pulse as recorded and as estimated, speed with its band.

import { Charts } from "./charts.js";
import { colour, hear, read, whenSeen } from "./page.js";
import { PER_MPS, signed, t } from "./words.js";

const SIGMAS_95 = 1.96;
/** km/h in the reader's unit. @type {Converted} */
const speeds = (values) => values.map((v) => v === null ? v : v * PER_MPS / 3.6);

/** @type {Promise<EventDocument> | undefined} */
let asked;
/** The canonical JSON of the page's event, asked for once. @param {Element} element */
export const eventDocument = (element) => (asked ??= read(element.getAttribute("document") ?? ""));

class EventCharts extends Charts {
  connectedCallback() {
    const draw = () => void this.#draw();
    whenSeen(this, () => { draw(); this.keepUp(draw); });
    hear("change", ({ kind, revision, event_id: id = "-" }) => {
      // A further revision of this event.
      if (kind !== "event" || !revision || !this.getAttribute("document")?.includes(id)) return;
      asked = undefined;
      draw();
    });
  }

  async #draw() {
    const found = await eventDocument(this).catch(() => undefined);
    if (!found) { this.say(t("The curves could not be read")); return; }
    this.discard();
    const { pulse, trajectory } = found.curves;
    if (pulse) {
      const after = speeds(pulse.sigma_kmh).map((sigma, k) => ((pulse.t_s[k] ?? -1) >= 0 ? sigma : 0));
      const along = { stroke: colour("axis-x") }, across = { stroke: colour("axis-y") }, dash = [5, 4];
      this.#plot("dv", "ms", pulse.t_s, [{ ...along, values: speeds(pulse.delta_v_kmh_x), sigma: after }, { ...across, values: speeds(pulse.delta_v_kmh_y), sigma: after }]);
      const clipped = pulse.clipped.some(Boolean);
      this.querySelector("[data-clipped]")?.toggleAttribute("hidden", !clipped);
      this.#plot("pulse", "ms", pulse.t_s, [
        { ...along, values: pulse.recorded_g_x }, { ...across, values: pulse.recorded_g_y },
        ...(clipped ? [{ ...along, dash, values: pulse.acceleration_g_x }, { ...across, dash, values: pulse.acceleration_g_y }] : []),
      ]);
    }
    if (trajectory) this.#plot("speed", "s", trajectory.t_s, [{ values: speeds(trajectory.speed_kmh), stroke: colour("track"), sigma: speeds(trajectory.speed_sigma_kmh) }]);
    this.say(t("Time counts from time zero."));
    this.dataset.drawn = String(Object.keys(this.plots).length);
  }

  /** @param {string} name @param {string} unit @param {Column} x @param {Curve[]} curves */
  #plot(name, unit, x, curves) {
    const columns = [x];
    /** @type {ChartOptions["lines"]} */ const lines = [];
    /** @type {ChartOptions["bands"]} */ const bands = [];
    for (const [k, { values, sigma, ...line }] of curves.entries()) {
      if (sigma) {
        const reach = (/** @type {1 | -1} */ side) => values.map((v, k) => (v === null || sigma[k] == null ? null : v + side * SIGMAS_95 * sigma[k]));
        columns.push(reach(1), reach(-1));
        lines.push({}, {});
        bands.push({ series: [lines.length - 1, lines.length], fill: `${line.stroke}33` });
      }
      columns.push(values);
      lines.push({ ...line, label: name + k });
    }
    this.plot(name, {
      lines, bands, scales: { x: { time: false } }, ticks: (_, values) => values.map((value) => `${signed(unit === "s" ? value : 1000 * value)} ${unit}`),
    }, columns);
  }
}

customElements.define("event-charts", EventCharts);
