// What the charts of signals, of events and of the live page have in common.

import uPlot from "../vendor/uplot/uplot.mjs";
import { colour, dark, hear, tell } from "./page.js";
import { formatter } from "./time.js";
import { signed } from "./words.js";

/** An element with plots, each in a place `data-plot="name"`, and a line of words. */
export class Charts extends HTMLElement {
  /** By name. @type {Record<string, Plot>} */ plots = {};

  /** Fit the width, follow the page's instant; draw anew in other colours or another zone. @param {() => void} draw */
  keepUp(draw) {
    const anew = () => { this.discard(); draw(); };
    dark.addEventListener("change", anew);
    hear("zone", anew);
    hear("place", ({ at }) => {
      for (const plot of Object.values(this.plots)) plot.setCursor({ left: plot.valToPos(at, "x"), top: 1 });
    });
    this.addEventListener("keydown", (event) => this.#lead(event));
    new ResizeObserver(() => {
      for (const plot of Object.values(this.plots)) {
        const width = plot.root.parentElement?.clientWidth;
        if (width) plot.setSize({ width, height: plot.height });
      }
    }).observe(this);
  }

  /** A plot as high as its place. @param {string} name @param {ChartOptions} options @param {Column[]} columns */
  plot(name, { lines, ticks = clockWords, hooks, cursor, ...more }, columns) {
    const host = /** @type {HTMLElement} */ (this.querySelector(`[data-plot="${name}"]`));
    const axis = { stroke: colour("muted"), grid: { stroke: colour("line"), width: 1 }, ticks: { show: false } };
    return (this.plots[name] = new uPlot({
      width: host.clientWidth, height: host.clientHeight, legend: { show: false },
      axes: [{ ...axis, space: 90, size: 30, values: ticks }, { ...axis, size: 48, values: (_, values) => values.map((value) => signed(value)) }],
      series: [{}, ...lines.map((line) => ({ width: 1.5, points: { show: false }, ...line }))],
      scales: { x: { auto: false }, y: { range: quiet } },
      cursor: { sync: { key: "page" }, points: { size: 6 }, y: false, ...cursor },
      hooks: { ...hooks, setCursor: [(plot) => this.#read(plot, name, ticks)] },
      ...more,
    }, /** @type {PlotData} */ (columns), host));
  }

  /** Arrows lead the cursor of the plot in focus by a sample, other keys by a twentieth of the view or to its ends. @param {KeyboardEvent} event */
  #lead(event) {
    const plot = event.target instanceof HTMLElement && this.plots[event.target.dataset.plot ?? ""];
    const [first, last] = plot && plot.series[0]?.idxs || [0, 0], leap = (last - first) / 20;
    const step = { ArrowLeft: -1, ArrowRight: 1, PageDown: -leap, PageUp: leap, Home: -Infinity, End: Infinity }[event.key];
    if (!plot || !step) return;
    event.preventDefault();
    const row = Math.round(Math.min(Math.max((plot.cursor.idx ?? first) + step, first), last));
    tell("place", { at: plot.data[0][row] ?? 0 });
  }

  /** What is under the cursor: beside the names of the lines, and for the rest of the page. @param {Plot} plot @param {string} name @param {Ticks} ticks */
  #read(plot, name, ticks) {
    const { cursor: { idx, left = -1 }, series, data, root, posToVal } = plot, values = data.map((column) => column[idx ?? -1]);
    series.forEach(({ label }, k) => this.put("now", `${label}`, values[k], 2));
    const host = root.parentElement, key = host?.previousElementSibling?.lastElementChild;
    if (host && host === document.activeElement && key instanceof HTMLElement) host.ariaValueText = `${ticks(plot, [values[0] ?? 0])} ${key.innerText}`;
    // The rest of the page follows the last plot, whose time reaches farthest.
    if (name === Object.keys(this.plots).at(-1)) tell("cursor", { at: left < 0 ? null : posToVal(left, "x"), values: values.slice(1), frame: this.dataset.frame });
  }

  /** Run when the reader presses a button; it stands among `data-choice`, or not. @param {(button: HTMLButtonElement, choice: string | undefined) => void} run */
  onPress(run) {
    this.addEventListener("click", ({ target }) => {
      const button = target instanceof Element && target.closest("button");
      if (button) run(button, button.parentElement?.dataset.choice);
    });
  }

  /** Show what is chosen. @param {string} choice @param {string | number} value */
  press(choice, value) {
    for (const button of this.querySelectorAll(`[data-choice="${choice}"] button`)) button.ariaPressed = String(button.getAttribute("value") === `${value}`);
  }

  /** @param {string} kind @param {string} name @param {Value} value @param {number} digits */
  put(kind, name, value, digits) {
    const place = this.querySelector(`[data-${kind}="${name}"]`);
    if (place) place.textContent = typeof value === "number" ? signed(value, digits) : "";
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

/** A quiet signal keeps a span that shows it as quiet. @type {ValueRange} */
function quiet(_, low, high) {
  const middle = (low + high) / 2, reach = 0.55 * Math.max(high - low, 2);
  return [middle - reach, middle + reach];
}

/** Time of day, with the fraction when the window is short. @type {Ticks} */
function clockWords(_, ticks) {
  const step = (ticks[1] ?? 0) - (ticks[0] ?? 0);
  const clock = formatter({ hour: "2-digit", minute: "2-digit", ...(step < 60 && { second: "2-digit" }), ...(step < 1 && { fractionalSecondDigits: 2 }) });
  return ticks.map((tick) => clock.format(tick * 1000));
}
