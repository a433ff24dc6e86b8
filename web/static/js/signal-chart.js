// <signal-chart device="id" mounting="id of that part" last="id of the trips' part">: speed and specific force over one time axis.
// Dragging zooms and fetches again at the new resolution; a double click goes back.  The address names the window.

import { Charts } from "./charts.js";
import { colour, gathered, hear, told } from "./page.js";
import { fetchSignals, iso } from "./signals.js";
import { t } from "./words.js";

/** Columns and their colours. */
const FORCE = { fx: "axis-x", fy: "axis-y", fz: "axis-z" }, SPEED = { speed: "track" };
const SHOWN_S = 60, REFETCH_MS = 1500;

class SignalChart extends Charts {
  /** @type {TimeWindow} */ #view = { seconds: SHOWN_S };
  /** @type {TimeWindow[]} */ #back = [];
  /** Whether the view is that of the trip that the page shows, whichever that becomes. */
  #onTrip = false;
  /** The axes that the reader chose; until then they are the vehicle's as soon as it is known how the box sits. */
  #chosen = "";
  #asked = "";
  #asking = new AbortController();
  /** @type {Signals | undefined} */ #signals;

  connectedCallback() {
    this.#offer();
    this.onPress((button, choice) => {
      if (choice === "frame") {
        this.#chosen = button.value;
        this.press(choice, button.value);
        void this.#fetch();
      } else if (choice) {
        this.#back = [];
        this.#onTrip = button.value === "trip";
        this.#show(this.#onTrip ? this.#trip : { seconds: Number(button.value) });
      }
    });
    hear("parts", () => {
      this.#offer();
      const trip = this.#trip;
      if (this.#onTrip && "from" in this.#view && this.#view.from !== trip.from) this.#show(trip);
      else if (this.#frame !== this.#asked) void this.#fetch();
    });
    const fetchSoon = gathered(REFETCH_MS, () => void this.#fetch());
    hear("change", ({ device_id: id }) => {
      if (id === this.getAttribute("device") && "seconds" in this.#view) fetchSoon();
    });
    this.keepUp(() => this.#draw());
    // The address names the window, so that it can be sent to somebody.
    const { from, to, seconds } = Object.fromEntries(new URLSearchParams(location.search));
    this.#show(from && to ? { from, to } : { seconds: Math.max(Number(seconds), 0) || SHOWN_S });
  }

  /** Look through another window. @param {TimeWindow} view */
  #show(view) {
    this.#view = view;
    this.press("view", "seconds" in view ? view.seconds : view.from === this.#trip.from ? "trip" : "");
    const address = new URL(location.href);
    for (const name of ["from", "to", "seconds"]) address.searchParams.delete(name);
    for (const [name, value] of Object.entries(view)) if (value !== SHOWN_S) address.searchParams.set(name, String(value));
    history.replaceState(null, "", address);
    void this.#fetch();
  }

  get #mounted() { return told(this.getAttribute("mounting")).known === "yes"; }

  get #trip() {
    const { from = "", to = "" } = told(this.getAttribute("last"));
    return { from, to };
  }

  get #frame() { return this.#chosen || (this.#mounted ? "v" : "a"); }

  /** Offer what the page knows by now. */
  #offer() {
    this.querySelector('button[value="trip"]')?.toggleAttribute("disabled", !this.#trip.from);
    this.press("frame", this.#frame);
  }

  async #fetch() {
    this.#asking.abort();
    const { signal } = (this.#asking = new AbortController());
    const points = Math.round(Math.min(Math.max(this.clientWidth, 300), 2000) * 1.5);
    const query = { columns: Object.keys({ ...FORCE, ...SPEED }).join(), frame: this.#asked = this.#frame, points, ...this.#view };
    const found = await fetchSignals(this.getAttribute("device"), query, signal).catch((/** @type {Error} */ problem) => problem);
    if (signal.aborted) return;
    if (found instanceof Error) { this.say(found.message); return; }
    this.#signals = found;
    this.#draw();
  }

  #draw() {
    if (!this.#signals) return;
    const { header, series } = this.#signals;
    this.dataset.frame = header.frame;
    this.#put("speed", SPEED, series, { x: { auto: false }, y: { range: (_, _low, high) => [0, Math.max(high, 20) * 1.1] } });
    this.#put("force", FORCE, series);
    this.#reach(header.from, header.to);
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

  /** @param {string} name @param {Record<string, string>} columns @param {Signals["series"]} series @param {PlotOptions["scales"]} [scales] */
  #put(name, columns, series, scales) {
    const names = Object.keys(columns), times = series[names[0] ?? ""]?.t ?? [];
    const plot = this.plots[name] ?? this.plot(name, {
      lines: Object.values(columns).map((one, k) => ({ stroke: colour(one), label: name + k })), ...(scales && { scales }),
      cursor: { drag: { setScale: false }, bind: { dblclick: () => () => { this.#show(this.#back.pop() ?? this.#view); return null; } } },
      hooks: { setSelect: [(plot) => this.#zoom(plot)] },
    }, [[], ...names.map(() => [])]);
    plot.root.hidden = !times.length;
    plot.setData([times, ...names.map((one) => series[one]?.values ?? [])], false);
  }

  /** @param {string} from @param {string} to */
  #reach(from, to) {
    for (const plot of Object.values(this.plots)) plot.setScale("x", { min: Date.parse(from) / 1000, max: Date.parse(to) / 1000 });
  }

  /** @param {Plot} plot */
  #zoom({ select: { left, width }, posToVal }) {
    if (width < 8) return;
    this.#onTrip = false;
    this.#back.push(this.#view);
    const from = iso(posToVal(left, "x")), to = iso(posToVal(left + width, "x"));
    for (const one of Object.values(this.plots)) one.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    this.#reach(from, to);
    this.#show({ from, to });
  }
}

customElements.define("signal-chart", SignalChart);
