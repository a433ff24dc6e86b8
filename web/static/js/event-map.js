// <event-map document="url" tiles="" pmtiles="">: the way before and after an event, its 95 % ellipses, where it happened and ended.

import { GroundMap, METRES_PER_DEGREE, feature } from "./basemap.js";
import { eventDocument } from "./event-charts.js";
import { hear, whenSeen } from "./page.js";
import { t } from "./words.js";

const SHOWN_BEFORE_S = 20, SHOWN_AFTER_S = 10, ELLIPSE_EVERY_S = 5;

class EventMap extends GroundMap {
  connectedCallback() { whenSeen(this, () => void this.#draw()); }

  async #draw() {
    const found = await eventDocument(this).catch(() => undefined), way = found?.curves.trajectory;
    if (!way) return;
    const { rest, t0_s } = found.event, points = placed(way);
    await this.open("event", () => features(way, points, rest && rest.t_s - t0_s));
    const near = points.filter(({ t }) => t >= -SHOWN_BEFORE_S && t <= SHOWN_AFTER_S);
    this.fit("way", (near.length ? near : points).map(({ place }) => place), 18);
    hear("cursor", ({ at }) => {
      this.put({ cursor: mark(points, at) });
      this.dataset.cursor = `${at ?? ""}`;
    });
    this.dataset.points = String(points.length);
  }
}

/** @param {Way} way @returns {Point[]} */
const placed = ({ t_s, lat_deg, lon_deg }) => t_s.flatMap((t, k) => {
  const lat = lat_deg[k], lon = lon_deg[k];
  return t !== null && lat != null && lon != null ? [{ t, place: [lon, lat], k }] : [];
});

/** @param {Way} way @param {Point[]} points @param {number | null} rest */
function features(way, points, rest) {
  const line = (/** @type {string} */ when, from = -Infinity, to = Infinity) => {
    const part = points.filter(({ t }) => t >= from && t <= to);
    return part.length > 1 ? [feature("LineString", part.map(({ place }) => place), { when })] : [];
  };
  const every = points.filter(({ t }, n) => Math.floor(t / ELLIPSE_EVERY_S) !== Math.floor((points[n - 1]?.t ?? NaN) / ELLIPSE_EVERY_S));
  return {
    way: [...line("before", -Infinity, 0), ...line("last", -5, 0), ...line("after", 0)],
    ellipses: every.flatMap(({ place, k }) => ellipse(place, way.ellipse_long_m[k], way.ellipse_short_m[k], way.ellipse_deg[k])),
    marks: [...mark(points, 0, "impact", t("impact")), ...mark(points, rest, "rest", t("rest"))],
  };
}

/** At an instant. @type {Mark} */
const mark = (points, wanted, words, say) => {
  if (wanted === null || !points[0]) return [];
  const nearest = points.reduce((best, p) => (Math.abs(p.t - wanted) < Math.abs(best.t - wanted) ? p : best));
  return [feature("Point", nearest.place, { words, say })];
};

/** An ellipse on the ground. @type {Ellipse} */
const ellipse = ([lon, lat], long, short, turn) => {
  if (long == null || short == null || turn == null) return [];
  const angle = (turn * Math.PI) / 180, east = METRES_PER_DEGREE * Math.cos((lat * Math.PI) / 180);
  const ring = Array.from({ length: 41 }, (_, k) => {
    const a = long * Math.cos((k * Math.PI) / 20), b = short * Math.sin((k * Math.PI) / 20);
    return [lon + (a * Math.sin(angle) + b * Math.cos(angle)) / east, lat + (a * Math.cos(angle) - b * Math.sin(angle)) / METRES_PER_DEGREE];
  });
  return [feature("Polygon", [ring])];
};

customElements.define("event-map", EventMap);
