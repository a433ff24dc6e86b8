// <event-map document="url" tiles="" pmtiles="">: the way before and after an event, its 95 % ellipses, where it happened and ended.

import { ROUND, collection, fit, makeMap, namedPoints } from "./basemap.js";
import { eventDocument } from "./event-document.js";
import { colour } from "./palette.js";
import { whenSeen } from "./seen.js";
import { t } from "./words.js";

const METRES_PER_DEGREE = 111_320;
const SHOWN_BEFORE_S = 20, SHOWN_AFTER_S = 10, ELLIPSE_EVERY_S = 5;

class EventMap extends HTMLElement {
  /** @type {MapView | undefined} */ #map;
  #lines = collection([]);
  #ellipses = collection([]);
  #marks = collection([]);
  #upright = false;

  connectedCallback() { whenSeen(this, () => void this.#open()); }

  async #open() {
    let found;
    try { found = await eventDocument(this.getAttribute("document") ?? ""); } catch { return; }
    const way = found.curves.trajectory;
    if (!way) return;
    const rest = found.event.rest ? found.event.rest.t_s - found.event.t0_s : null;
    const points = this.#lay(way, rest);
    this.#map = makeMap(this, (map) => this.#dress(map));
    const near = points.filter(({ t }) => t >= -SHOWN_BEFORE_S && t <= SHOWN_AFTER_S).map(({ place }) => place);
    fit(this.#map, near.length ? near : points.map(({ place }) => place), 18);
    this.dataset.points = String(points.length);
  }

  /** @param {Way} way @param {number | null} rest */
  #lay(way, rest) {
    /** @type {{t: number, place: LonLat, k: number}[]} */
    const points = [];
    way.t_s.forEach((t, k) => {
      const lat = way.lat_deg[k], lon = way.lon_deg[k];
      if (t !== null && typeof lat === "number" && typeof lon === "number") points.push({ t, place: [lon, lat], k });
    });
    const line = (/** @type {string} */ when, /** @type {typeof points} */ part) => (
      { type: "Feature", properties: { when }, geometry: { type: "LineString", coordinates: part.map(({ place }) => place) } });
    this.#lines = collection([
      line("before", points.filter(({ t }) => t <= 0)), line("last", points.filter(({ t }) => t >= -5 && t <= 0)), line("after", points.filter(({ t }) => t >= 0)),
    ].filter((feature) => feature.geometry.coordinates.length > 1));
    const every = points.filter(({ t }, n) => n === 0 || Math.floor(t / ELLIPSE_EVERY_S) !== Math.floor((points[n - 1]?.t ?? t) / ELLIPSE_EVERY_S));
    this.#ellipses = collection(every.flatMap(({ place, k }) => ellipse(place, way.ellipse_long_m[k], way.ellipse_short_m[k], way.ellipse_deg[k])));
    const nearest = (/** @type {number} */ wanted) => points.reduce((best, p) => (Math.abs(p.t - wanted) < Math.abs(best.t - wanted) ? p : best), /** @type {typeof points[0]} */ (points[0]));
    const marks = points.length ? [{ words: "impact", place: nearest(0).place }, ...(rest !== null ? [{ words: "rest", place: nearest(rest).place }] : [])] : [];
    // Words go beside the way, not along it.
    if (points.length) {
      const [lon0, lat0] = nearest(-2).place, [lon1, lat1] = nearest(0).place;
      this.#upright = Math.abs(lat1 - lat0) > Math.abs(lon1 - lon0) * Math.cos((lat1 * Math.PI) / 180);
    }
    this.#marks = collection(marks.map(({ words, place }) => ({ type: "Feature", properties: { words, say: words === "impact" ? t("impact") : t("rest") }, geometry: { type: "Point", coordinates: place } })));
    return points;
  }

  /** @param {MapView} map */
  #dress(map) {
    map.addSource("way", { type: "geojson", data: this.#lines });
    map.addSource("ellipses", { type: "geojson", data: this.#ellipses });
    map.addLayer({ id: "ellipses", type: "fill", source: "ellipses", paint: { "fill-color": colour("track"), "fill-opacity": 0.12 } });
    map.addLayer({ id: "ellipse-edges", type: "line", source: "ellipses", paint: { "line-color": colour("map-ink"), "line-width": 0.8 } });
    map.addLayer({
      id: "way", type: "line", source: "way", layout: ROUND,
      paint: {
        "line-color": ["match", ["get", "when"], "after", colour("alarm-fill"), colour("track")],
        "line-width": ["match", ["get", "when"], "last", 5, 3], "line-opacity": ["match", ["get", "when"], "before", 0.6, 1],
      },
    });
    namedPoints(map, "marks", this.#marks, ["match", ["get", "words"], "impact", colour("alarm-fill"), colour("ink")], colour("card"), this.#upright);
  }
}

/** An ellipse on the ground. @param {LonLat} place @param {number | null | undefined} long m @param {number | null | undefined} short m @param {number | null | undefined} turn degrees from north */
function ellipse([lon, lat], long, short, turn) {
  if (typeof long !== "number" || typeof short !== "number" || typeof turn !== "number") return [];
  const angle = (turn * Math.PI) / 180, east = METRES_PER_DEGREE * Math.cos((lat * Math.PI) / 180);
  const ring = Array.from({ length: 41 }, (_, k) => {
    const a = long * Math.cos((k * Math.PI) / 20), b = short * Math.sin((k * Math.PI) / 20);
    return [lon + (a * Math.sin(angle) + b * Math.cos(angle)) / east, lat + (a * Math.cos(angle) - b * Math.sin(angle)) / METRES_PER_DEGREE];
  });
  return [{ type: "Feature", properties: {}, geometry: { type: "Polygon", coordinates: [ring] } }];
}

customElements.define("event-map", EventMap);
