// <event-charts document="url">: delta-V with its band, the pulse as recorded and as estimated, speed with its band.

import uPlot from "../vendor/uplot/uplot.mjs";
import { eventDocument, forgetDocuments } from "./event-document.js";
import { chartAxis, colour } from "./palette.js";
import { whenSeen } from "./seen.js";
import { SPEED, t } from "./words.js";

const HEIGHT = 210;
const SIGMAS_95 = 1.96;
/** km/h in the reader's unit. @param {Column} values @returns {Column} */
const speeds = (values) => values.map((v) => v === null ? v : v * SPEED.perMps / 3.6);

class EventCharts extends HTMLElement {
  /** @type {uPlot[]} */ #plots = [];

  connectedCallback() {
    this.innerHTML = `
      <p class="chart-head"><b>${t("Change of velocity")} <span class="unit">${SPEED.unit}, 95 %</span></b><span data-keys="dv"></span></p><div class="plot" data-plot="dv"></div>
      <p class="chart-head"><b>${t("Acceleration, gravity removed")} <span class="unit">g</span></b><span data-keys="pulse"></span></p><div class="plot" data-plot="pulse"></div>
      <p class="chart-head"><b>${t("Speed")} <span class="unit">${SPEED.unit}, 95 %</span></b></p><div class="plot" data-plot="speed"></div>
      <p class="chart-words" role="status">${t("Reading the curves")}</p>`;
    whenSeen(this, () => void this.#draw());
    document.addEventListener("scatola:change", this.#onChange);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => void this.#draw());
    new ResizeObserver(() => { for (const plot of this.#plots) plot.setSize({ width: plot.root.parentElement?.clientWidth || 300, height: HEIGHT }); }).observe(this);
  }

  /** A further revision of this event. @param {Event} event */
  #onChange = (event) => {
    const change = /** @type {CustomEvent<{kind: string, event_id?: string, revision?: number}>} */ (event).detail;
    if (change.kind !== "event" || !change.revision || !this.getAttribute("document")?.includes(change.event_id ?? "-")) return;
    forgetDocuments();
    void this.#draw();
  };

  async #draw() {
    const words = /** @type {HTMLElement} */ (this.querySelector(".chart-words"));
    let found;
    try {
      found = await eventDocument(this.getAttribute("document") ?? "");
    } catch {
      words.textContent = t("The curves could not be read");
      return;
    }
    for (const plot of this.#plots) plot.destroy();
    this.#plots = [];
    const { pulse, trajectory } = found.curves;
    if (pulse) {
      const ms = pulse.t_s.map((t) => (t === null ? null : 1000 * t));
      const after = speeds(pulse.sigma_kmh).map((sigma, k) => ((pulse.t_s[k] ?? -1) >= 0 ? sigma : 0));
      this.#plot("dv", "ms", ms, [
        { label: t("longitudinal"), values: speeds(pulse.delta_v_kmh_x), stroke: colour("axis-x"), sigma: after },
        { label: t("lateral"), values: speeds(pulse.delta_v_kmh_y), stroke: colour("axis-y"), sigma: after },
      ]);
      /** @type {Curve[]} */
      const curves = [
        { label: t("longitudinal"), values: pulse.recorded_g_x, stroke: colour("axis-x") },
        { label: t("lateral"), values: pulse.recorded_g_y, stroke: colour("axis-y") },
      ];
      if (pulse.clipped.some(Boolean)) {
        curves.push(
          { label: t("dashed: with the estimate of what was clipped"), values: pulse.acceleration_g_x, stroke: colour("axis-x"), dash: [5, 4] },
          { label: "", values: pulse.acceleration_g_y, stroke: colour("axis-y"), dash: [5, 4] },
        );
      }
      this.#plot("pulse", "ms", ms, curves);
    }
    if (trajectory) this.#plot("speed", "s", trajectory.t_s, [{ label: "", values: speeds(trajectory.speed_kmh), stroke: colour("track"), sigma: speeds(trajectory.speed_sigma_kmh) }]);
    words.textContent = t("Time counts from time zero.");
    this.dataset.drawn = String(this.#plots.length);
  }

  /** @param {string} name @param {string} unit @param {Column} x @param {Curve[]} curves */
  #plot(name, unit, x, curves) {
    const host = /** @type {HTMLElement} */ (this.querySelector(`[data-plot="${name}"]`));
    host.replaceChildren();
    const keys = this.querySelector(`[data-keys="${name}"]`);
    if (keys) keys.innerHTML = curves.filter((c) => c.label).map(key).join("");
    /** @type {Column[]} */ const columns = [x];
    /** @type {uPlot.Series[]} */ const series = [{ label: unit }];
    /** @type {uPlot.Band[]} */ const bands = [];
    for (const { label, values, stroke, dash, sigma } of curves) {
      if (sigma) {
        const reach = (/** @type {1 | -1} */ side) => values.map((v, k) => (v === null || sigma[k] === null || sigma[k] === undefined ? null : v + side * SIGMAS_95 * sigma[k]));
        columns.push(reach(1), reach(-1));
        series.push({ points: { show: false } }, { points: { show: false } });
        bands.push({ series: [series.length - 2, series.length - 1], fill: `${stroke}33` });
      }
      columns.push(values);
      series.push({ label, stroke, width: 1.8, ...(dash && { dash }), points: { show: false } });
    }
    const axis = chartAxis();
    this.#plots.push(new uPlot({
      width: host.clientWidth, height: HEIGHT, legend: { show: false }, scales: { x: { time: false } }, series, bands,
      cursor: { drag: { x: true, y: false }, points: { size: 6 }, ...(name !== "speed" && { sync: { key: "event" } }) },
      axes: [{ ...axis, size: 30, values: (_, ticks) => ticks.map((t) => `${String(t).replace("-", "−")} ${unit}`) }, { ...axis, size: 48, values: (_, ticks) => ticks.map((t) => String(t).replace("-", "−")) }],
    }, /** @type {uPlot.AlignedData} */ (/** @type {unknown} */ (columns)), host));
  }
}

/** @param {Curve} curve */
function key({ label, stroke }) {
  return `<span class="chart-key"><svg width="14" height="3"><rect width="14" height="3" fill="${stroke}"/></svg> ${label} </span>`;
}

customElements.define("event-charts", EventCharts);
