// What the charts of signals, of events and of the live page have in common.

import uPlot from "../vendor/uplot/uplot.mjs";
import { colour, onScheme } from "./palette.js";
import { formatter } from "./time.js";

/** An element with plots, each in a place `data-plot="name"`, and a line of words. */
export class Charts extends HTMLElement {
  /** By name. @type {Record<string, Plot>} */ plots = {};

  /** Fit the width; draw anew in other colours or another zone. @param {() => void} draw */
  keepUp(draw) {
    const anew = () => { this.discard(); draw(); };
    onScheme(anew);
    document.addEventListener("scatola:zone", anew);
    new ResizeObserver(() => {
      for (const plot of Object.values(this.plots)) {
        const width = plot.root.parentElement?.clientWidth;
        if (width) plot.setSize({ width, height: plot.height });
      }
    }).observe(this);
  }

  /** A plot as high as its place. @param {string} name @param {ChartOptions} options @param {Column[]} columns */
  plot(name, { lines, ticks = clockWords, ...more }, columns) {
    const host = /** @type {HTMLElement} */ (this.querySelector(`[data-plot="${name}"]`));
    const axis = { stroke: colour("muted"), grid: { stroke: colour("line"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif" };
    return (this.plots[name] = new uPlot({
      width: host.clientWidth, height: host.clientHeight, legend: { show: false },
      axes: [{ ...axis, space: 90, size: 30, values: ticks }, { ...axis, size: 48, values: (_, values) => values.map(signed) }],
      series: [{}, ...lines.map((line) => ({ width: 1.5, points: { show: false }, ...line }))],
      ...more,
    }, /** @type {PlotData} */ (columns), host));
  }

  discard() {
    for (const plot of Object.values(this.plots)) plot.destroy();
    this.plots = {};
  }

  /** @param {string} words */
  say(words) {
    const line = this.querySelector(".chart-words");
    if (line) line.textContent = words;
  }
}

/** With the sign that typography has for minus. @param {number} value */
export const signed = (value) => String(value).replace("-", "−");

/** Time of day, with the fraction when the window is short. @type {Ticks} */
function clockWords(_, ticks) {
  const step = (ticks[1] ?? 0) - (ticks[0] ?? 0);
  const clock = formatter({ hour: "2-digit", minute: "2-digit", ...(step < 60 && { second: "2-digit" }), ...(step < 1 && { fractionalSecondDigits: 2 }) });
  return ticks.map((tick) => clock.format(tick * 1000));
}
