// <signal-chart device="id" mounting="id of that part" last="id of the trips' part">: speed and specific force over one time axis.
// Dragging zooms and fetches again at the new resolution; a double click goes back.  The address names the window.

import { Charts } from "./charts.js";
import { gathered, pressedButton, told } from "./page.js";
import { colour } from "./palette.js";
import { fetchSignals, iso } from "./signals.js";
import { SPEED, t } from "./words.js";

const FORCE = ["fx", "fy", "fz"];
const REFETCH_MS = 1500;

class SignalChart extends Charts {
  /** @type {TimeWindow} */ #view = { seconds: 60 };
  /** @type {TimeWindow[]} */ #back = [];
  /** Whether the view is that of the trip that the page shows, whichever that becomes. */
  #onTrip = false;
  /** @type {"a" | "v"} */ #frame = "a";
  /** Whether the reader has chosen the axes; until then they are the vehicle's as soon as it is known how the box sits. */
  #chosen = false;
  #asking = new AbortController();
  /** @type {Signals | undefined} */ #signals;
  teller = "force";

  connectedCallback() {
    this.#fromAddress();
    this.#follow();
    this.addEventListener("click", this.#onClick);
    document.addEventListener("scatola:parts", this.#onParts);
    const fetchSoon = gathered(REFETCH_MS, () => void this.#fetch());
    document.addEventListener("scatola:change", ({ detail }) => {
      if (detail.device_id === this.getAttribute("device") && "seconds" in this.#view) fetchSoon();
    });
    document.addEventListener("scatola:place", ({ detail }) => {
      for (const plot of Object.values(this.plots)) plot.setCursor({ left: plot.valToPos(detail.at, "x"), top: 1 });
    });
    this.keepUp(() => this.#draw());
    void this.#fetch();
  }

  /** The window that the address names, so that it can be sent to somebody. */
  #fromAddress() {
    const asked = new URLSearchParams(location.search);
    const from = asked.get("from"), to = asked.get("to"), seconds = Number(asked.get("seconds"));
    this.#view = from && to ? { from, to } : { seconds: seconds > 0 ? seconds : 60 };
    this.#pressView();
  }

  /** Look through another window. @param {TimeWindow} view */
  #show(view) {
    this.#view = view;
    this.#pressView();
    const address = new URL(location.href);
    for (const name of ["from", "to", "seconds"]) address.searchParams.delete(name);
    for (const [name, value] of Object.entries(view)) if (value !== 60) address.searchParams.set(name, String(value));
    history.replaceState(null, "", address);
    void this.#fetch();
  }

  /** @param {Event} event */
  #onClick = (event) => {
    const button = pressedButton(event), choice = button?.parentElement?.dataset.choice;
    if (!button || !choice) return;
    if (choice === "frame") {
      this.#chosen = true;
      this.#frame = button.value === "v" ? "v" : "a";
      this.#press("frame", this.#frame);
      void this.#fetch();
    } else {
      this.#back = [];
      this.#onTrip = button.value === "trip";
      this.#show(this.#onTrip ? this.#trip : { seconds: Number(button.value) });
    }
  };

  get #mounted() { return told(this.getAttribute("mounting")).known === "yes"; }

  get #trip() {
    const { from = "", to = "" } = told(this.getAttribute("last"));
    return { from, to };
  }

  /** Offer what the page knows by now. @returns whether the axes changed */
  #follow() {
    this.querySelector('button[value="trip"]')?.toggleAttribute("disabled", !this.#trip.from);
    const before = this.#frame;
    if (!this.#chosen) this.#frame = this.#mounted ? "v" : "a";
    this.#press("frame", this.#frame);
    return this.#frame !== before;
  }

  #onParts = () => {
    const turned = this.#follow(), trip = this.#trip;
    if (this.#onTrip && "from" in this.#view && this.#view.from !== trip.from) this.#show(trip);
    else if (turned) void this.#fetch();
  };

  async #fetch() {
    this.#asking.abort();
    const { signal } = (this.#asking = new AbortController());
    const points = Math.round(Math.min(Math.max(this.clientWidth, 300), 2000) * 1.5);
    const query = { columns: [...FORCE, "speed"].join(), frame: this.#frame, points, ...this.#view };
    const found = await fetchSignals(this.getAttribute("device"), query, signal).catch((/** @type {Error} */ problem) => problem);
    if (signal.aborted) return;
    if (found instanceof Error) { this.say(found.message); return; }
    this.#signals = found;
    this.#draw();
  }

  #draw() {
    if (!this.#signals) return;
    const { header } = this.#signals;
    this.dataset.frame = header.frame;
    this.#put(this.plots.speed ?? this.#plot("speed", ["track"], speedRange), this.#signals, ["speed"], SPEED.perMps);
    this.#put(this.plots.force ?? this.#plot("force", ["axis-x", "axis-y", "axis-z"], forceRange), this.#signals, FORCE, 1);
    const count = header.groups.reduce((sum, group) => sum + group.count, 0);
    this.say(count ? this.#words(header) : t("Not yet: no samples in this window"));
    this.dataset.points = String(count);
  }

  /** @param {SignalHeader} header */
  #words(header) {
    const missing = header.frame === "a" && !this.#mounted ? t("Box axes: the mounting is not known yet.") : "";
    const gaps = header.gaps.length ? t("Gaps in the data: {n}.", { n: header.gaps.length }) : "";
    return [missing, gaps, this.#back.length ? t("Drag to zoom, double click to go back.") : t("Drag to zoom.")].filter(Boolean).join(" ");
  }

  /** @param {Plot} plot @param {Signals} signals @param {string[]} names @param {number} factor */
  #put(plot, { header, series }, names, factor) {
    const times = series[names[0] ?? ""]?.t ?? [];
    plot.root.hidden = !times.length;
    const values = names.map((name) => Array.from(series[name]?.values ?? [], (v) => (Number.isNaN(v) ? null : v * factor)));
    plot.setData([times, ...values], false);
    plot.setScale("x", { min: Date.parse(header.from) / 1000, max: Date.parse(header.to) / 1000 });
  }

  /** @param {string} name @param {string[]} colours @param {ValueRange} range */
  #plot(name, colours, range) {
    return this.plot(name, {
      lines: colours.map((one, k) => ({ stroke: colour(one), label: name + k })), scales: { x: { auto: false }, y: { range } },
      cursor: { sync: { key: "signals" }, drag: { x: true, y: false, setScale: false }, points: { size: 6 }, bind: { dblclick: () => () => { this.#zoomBack(); return null; } } },
      hooks: { setSelect: [(plot) => this.#zoom(plot)] },
    }, [[], ...colours.map(() => [])]);
  }

  /** @param {Plot} plot */
  #zoom(plot) {
    const { left, width } = plot.select;
    if (width < 8) return;
    const at = (/** @type {number} */ x) => iso(plot.posToVal(x, "x"));
    this.#back.push(this.#view);
    const from = at(left), to = at(left + width);
    for (const one of Object.values(this.plots)) {
      one.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
      one.setScale("x", { min: Date.parse(from) / 1000, max: Date.parse(to) / 1000 });
    }
    this.#show({ from, to });
  }

  #zoomBack() {
    const before = this.#back.pop();
    if (before) this.#show(before);
  }

  #pressView() {
    this.#press("view", "seconds" in this.#view ? this.#view.seconds : this.#view.from === this.#trip.from ? "trip" : "");
  }

  /** @param {string} choice @param {string | number} value */
  #press(choice, value) {
    for (const button of this.querySelectorAll(`[data-choice="${choice}"] button`)) button.ariaPressed = String(button.getAttribute("value") === String(value));
  }
}

// A quiet signal keeps a span that shows it as quiet.
/** @type {ValueRange} */
const speedRange = (_, _low, high) => [0, Math.max(high, 20) * 1.1];
/** @type {ValueRange} */
const forceRange = (_, low, high) => {
  const middle = (low + high) / 2, reach = 0.55 * Math.max(high - low, 2);
  return [middle - reach, middle + reach];
};

customElements.define("signal-chart", SignalChart);
