// <signal-chart device="id" mounting="id of that part" last="id of the trips' part">: speed and specific force over one time axis.
// Dragging zooms and fetches again at the new resolution; a double click goes back.  The address names the window.

import uPlot from "../vendor/uplot/uplot.mjs";
import { chartAxis, colour } from "./palette.js";
import { decode } from "./signals.js";
import { formatter } from "./time.js";
import { SPEED, t } from "./words.js";

const FORCE = ["fx", "fy", "fz"];
const AXIS = /** @type {const} */ (["axis-x", "axis-y", "axis-z"]);
const DIRECTIONS = [t("x forward"), t("y right"), t("z down")];
const SPANS = /** @type {const} */ ([[60, t("Last minute")], [600, t("10 minutes")], [3600, t("1 hour")], [21600, t("6 hours")]]);
const REFETCH_MS = 1500;
const HEIGHT = 180;

class SignalChart extends HTMLElement {
  /** @type {TimeWindow} */ #view = { seconds: 60 };
  /** @type {TimeWindow[]} */ #back = [];
  /** Whether the view is that of the trip that the page shows, whichever that becomes. */
  #onTrip = false;
  /** @type {"a" | "v"} */ #frame = "a";
  /** Whether the reader has chosen the axes; until then they are the vehicle's as soon as it is known how the box sits. */
  #chosen = false;
  /** @type {{speed: uPlot, force: uPlot} | undefined} */ #plots;
  /** @type {AbortController | undefined} */ #asking;
  /** @type {ReturnType<typeof setTimeout> | undefined} */ #later;
  /** @type {Signals | undefined} */ #signals;

  connectedCallback() {
    this.innerHTML = `
      <div class="chart-bar"><h2>${t("Signals")}</h2>
        <div class="choice" data-choice="view" role="group" aria-label="${t("Time span")}">
          ${SPANS.map(([seconds, words]) => `<button type="button" value="${seconds}">${words}</button>`).join("")}<button type="button" value="trip" disabled>${t("The trip")}</button>
        </div>
        <div class="choice" data-choice="frame" role="group" aria-label="${t("Axes")}">
          <button type="button" value="v">${t("Vehicle axes")}</button><button type="button" value="a">${t("Box axes")}</button>
        </div>
      </div>
      <p class="chart-head"><b>${t("Speed")} <span class="unit">${SPEED.unit}</span></b></p><div class="plot" data-plot="speed"></div>
      <p class="chart-head"><b>${t("Specific force")} <span class="unit">m/s²</span></b>${AXIS.map((axis, i) => `<span class="chart-key"><span class="axis ${axis}"></span><span data-key="${i}"></span></span>`).join("")}</p><div class="plot" data-plot="force"></div>
      <p class="chart-words" role="status"></p>`;
    this.#fromAddress();
    this.#follow();
    this.addEventListener("click", this.#onClick);
    document.addEventListener("scatola:parts", this.#onParts);
    document.addEventListener("scatola:change", this.#onChange);
    document.addEventListener("scatola:zone", this.#redraw);
    document.addEventListener("scatola:place", this.#onPlace);
    new ResizeObserver(() => this.#resize()).observe(this);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", this.#redraw);
    void this.#fetch();
  }

  #redraw = () => { this.#discard(); this.#draw(); };

  /** The window that the address names, so that it can be sent to somebody. */
  #fromAddress() {
    const asked = new URLSearchParams(location.search);
    const from = asked.get("from"), to = asked.get("to"), seconds = Number(asked.get("seconds"));
    this.#view = from && to ? { from, to } : { seconds: seconds > 0 ? seconds : 60 };
    this.#pressed("view", "seconds" in this.#view ? String(this.#view.seconds) : "");
  }

  #toAddress() {
    const address = new URL(location.href);
    for (const name of ["from", "to", "seconds"]) address.searchParams.delete(name);
    for (const [name, value] of Object.entries(this.#view)) if (value !== 60) address.searchParams.set(name, String(value));
    history.replaceState(null, "", address);
  }

  /** @param {Event} event */
  #onClick = (event) => {
    const button = event.target instanceof Element ? event.target.closest("button") : null;
    const choice = button?.closest("[data-choice]")?.getAttribute("data-choice");
    if (!button || !choice) return;
    this.#pressed(choice, button.value);
    if (choice === "frame") {
      this.#chosen = true;
      this.#frame = button.value === "v" ? "v" : "a";
    } else {
      this.#back = [];
      this.#onTrip = button.value === "trip";
      this.#view = this.#onTrip ? this.#trip() : { seconds: Number(button.value) };
      this.#toAddress();
    }
    void this.#fetch();
  };

  /** @param {"mounting" | "last"} attribute */
  #part(attribute) {
    return document.getElementById(this.getAttribute(attribute) ?? "")?.dataset ?? {};
  }

  get #mounted() { return this.#part("mounting").known === "yes"; }

  /** @returns {TimeWindow} */
  #trip() {
    const { from = "", to = "" } = this.#part("last");
    return { from, to };
  }

  /** Offer what the page knows by now. @returns whether the axes changed */
  #follow() {
    const trip = /** @type {HTMLButtonElement} */ (this.querySelector('button[value="trip"]'));
    trip.disabled = !this.#part("last").from;
    const before = this.#frame;
    if (!this.#chosen) this.#frame = this.#mounted ? "v" : "a";
    this.#pressed("frame", this.#frame);
    return this.#frame !== before;
  }

  #onParts = () => {
    let changed = this.#follow();
    const trip = this.#trip();
    if (this.#onTrip && "from" in this.#view && "from" in trip && this.#view.from !== trip.from) { this.#view = trip; this.#toAddress(); changed = true; }
    if (changed) void this.#fetch();
  };

  /** The instant under the pointer on the map. @param {Event} event */
  #onPlace = (event) => {
    const plot = this.#plots?.speed;
    if (plot) plot.setCursor({ left: plot.valToPos(/** @type {CustomEvent<{at: number}>} */ (event).detail.at, "x"), top: 1 });
  };

  /** New data of this box, while the chart follows the newest. @param {Event} event */
  #onChange = (event) => {
    const { device_id: device } = /** @type {CustomEvent<Change>} */ (event).detail;
    if (device !== this.getAttribute("device") || !("seconds" in this.#view)) return;
    this.#later ??= setTimeout(() => { this.#later = undefined; if (!document.hidden) void this.#fetch(); }, REFETCH_MS);
  };

  async #fetch() {
    this.#asking?.abort();
    const asking = (this.#asking = new AbortController());
    const points = Math.round(Math.min(Math.max(this.clientWidth, 300), 2000) * 1.5);
    const query = new URLSearchParams({ columns: [...FORCE, "speed"].join(), frame: this.#frame, points: String(points) });
    for (const [name, value] of Object.entries(this.#view)) query.set(name, String(value));
    try {
      const answer = await fetch(`/api/v1/devices/${this.getAttribute("device")}/signals?${query}`, { signal: asking.signal });
      if (!answer.ok) {
        const problem = /** @type {{detail?: string}} */ (await answer.json());
        this.#say(problem.detail ?? t("The signals could not be read"));
        return;
      }
      this.#signals = decode(await answer.arrayBuffer());
      this.#draw();
    } catch (error) {
      if (!asking.signal.aborted) { this.#say(t("The signals could not be read")); console.warn(error); }
    }
  }

  #draw() {
    if (!this.#signals) return;
    const { header, series } = this.#signals;
    const empty = header.groups.every((group) => group.count === 0);
    this.querySelectorAll("[data-key]").forEach((key, i) => { key.textContent = header.frame === "v" ? DIRECTIONS[i] ?? "" : "xyz"[i] ?? ""; });
    this.#plots ??= { speed: this.#plot("speed", [{ stroke: colour("track") }]), force: this.#plot("force", AXIS.map((axis) => ({ stroke: colour(axis) }))) };
    const t0 = Date.parse(header.t0) / 1000;
    const window = { min: Date.parse(header.from) / 1000, max: Date.parse(header.to) / 1000 };
    this.#put(this.#plots.speed, t0, window, [series.speed], SPEED.perMps);
    this.#put(this.#plots.force, t0, window, FORCE.map((name) => series[name]), 1);
    this.#say(empty ? t("Not yet: no samples in this window") : this.#words(header));
    this.dataset.points = String(header.groups.reduce((sum, group) => sum + group.count, 0));
  }

  /** @param {SignalHeader} header */
  #words(header) {
    const missing = header.frame === "a" && !this.#mounted ? t("Box axes: the mounting is not known yet.") : "";
    const gaps = header.gaps.length ? t("Gaps in the data: {n}.", { n: header.gaps.length }) : "";
    return [missing, gaps, this.#back.length ? t("Drag to zoom, double click to go back.") : t("Drag to zoom.")].filter(Boolean).join(" ");
  }

  /** @param {uPlot} plot @param {number} t0 @param {{min: number, max: number}} window @param {(Signals["series"][string] | undefined)[]} columns @param {number} factor */
  #put(plot, t0, window, columns, factor) {
    plot.root.hidden = !columns[0]?.t.length;
    const times = Array.from(columns[0]?.t ?? [], (t) => t0 + t);
    const values = columns.map((column) => Array.from(column?.values ?? [], (v) => (Number.isNaN(v) ? null : v * factor)));
    plot.setData(/** @type {uPlot.AlignedData} */ ([times, ...values]), false);
    plot.batch(() => {
      plot.setScale("x", window);
      const all = values.flat().filter((v) => v !== null);
      if (all.length === 0) return;
      const low = Math.min(...all), high = Math.max(...all);
      // A quiet signal keeps a span that shows it as quiet.
      const speeds = factor !== 1;
      const span = Math.max(high - low, speeds ? 20 : 2), middle = (low + high) / 2;
      const min = speeds ? 0 : middle - span * 0.55;
      plot.setScale("y", { min, max: speeds ? Math.max(high, 20) * 1.1 : middle + span * 0.55 });
    });
  }

  /** @param {string} name @param {{stroke: string}[]} lines */
  #plot(name, lines) {
    const host = /** @type {HTMLElement} */ (this.querySelector(`[data-plot="${name}"]`));
    const axis = chartAxis();
    /** @type {uPlot.Options} */
    const options = {
      width: host.clientWidth, height: HEIGHT, legend: { show: false }, scales: { x: { auto: false }, y: { auto: false } },
      cursor: { sync: { key: "signals" }, drag: { x: true, y: false, setScale: false }, points: { size: 6 }, bind: { dblclick: () => () => { this.#zoomBack(); return null; } } },
      axes: [{ ...axis, space: 90, size: 30, values: timeWords }, { ...axis, size: 48 }],
      series: [{}, ...lines.map(({ stroke }) => ({ stroke, width: 1.5, spanGaps: false, points: { show: false } }))],
      hooks: { setSelect: [(plot) => this.#zoom(plot)], ...(name === "speed" && { setCursor: [tell] }) },
    };
    return new uPlot(options, [[], ...lines.map(() => [])], host);
  }

  /** @param {uPlot} plot */
  #zoom(plot) {
    const { left, width } = plot.select;
    if (width < 8) return;
    const iso = (/** @type {number} */ x) => new Date(plot.posToVal(x, "x") * 1000).toISOString();
    this.#back.push(this.#view);
    this.#view = { from: iso(left), to: iso(left + width) };
    for (const one of Object.values(this.#plots ?? {})) one.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    this.#pressed("view", "");
    this.#toAddress();
    void this.#fetch();
  }

  #zoomBack() {
    const before = this.#back.pop();
    if (!before) return;
    this.#view = before;
    this.#pressed("view", "seconds" in before ? String(before.seconds) : this.#onTrip ? "trip" : "");
    this.#toAddress();
    void this.#fetch();
  }

  #resize() {
    for (const [name, plot] of Object.entries(this.#plots ?? {})) {
      const host = /** @type {HTMLElement} */ (this.querySelector(`[data-plot="${name}"]`));
      if (host.clientWidth > 0) plot.setSize({ width: host.clientWidth, height: HEIGHT });
    }
  }

  #discard() {
    for (const plot of Object.values(this.#plots ?? {})) plot.destroy();
    this.#plots = undefined;
  }

  /** @param {string} choice @param {string} value */
  #pressed(choice, value) {
    for (const button of this.querySelectorAll(`[data-choice="${choice}"] button`)) {
      button.setAttribute("aria-pressed", String(/** @type {HTMLButtonElement} */ (button).value === value));
    }
  }

  /** @param {string} words */
  #say(words) {
    const line = this.querySelector(".chart-words");
    if (line) line.textContent = words;
  }
}

/** Tick labels: time of day, with the fraction when the window is short. @param {uPlot} _ @param {number[]} ticks */
function timeWords(_, ticks) {
  const step = (ticks[1] ?? 0) - (ticks[0] ?? 0);
  /** @type {Intl.DateTimeFormatOptions} */
  const style = { hour: "2-digit", minute: "2-digit", ...(step < 60 && { second: "2-digit" }), ...(step < 1 && { fractionalSecondDigits: 2 }) };
  const format = formatter(style);
  return ticks.map((tick) => format.format(new Date(tick * 1000)));
}

/** Tells the map which instant is under the cursor. @param {uPlot} plot */
function tell({ cursor: { left = -1 }, posToVal }) {
  document.dispatchEvent(new CustomEvent("scatola:cursor", { detail: { at: left < 0 ? null : posToVal(left, "x") } }));
}

customElements.define("signal-chart", SignalChart);
