// <track-map last="id of the part that names the trip and position" tiles="" pmtiles="">: where the trip went, coloured
// by speed, or where the vehicle stands before the first.  The charts' cursor is a point on the way.

import { feature, fit, makeMap, note, put } from "./basemap.js";
import { fetched, told, whenSeen } from "./page.js";
import { t } from "./words.js";

class TrackMap extends HTMLElement {
  /** @type {MapView | undefined} */ #map;
  /** @type {LonLat[]} */ #points = [];
  /** Unix seconds of each point. @type {number[]} */ #at = [];
  /** @type {(number | null)[]} */ #speed = [];
  /** Where the vehicle stands, as long as there is no trip. @type {LonLat | undefined} */ #place;
  /** What is drawn: the trip and how far it had got. */
  #drawn = "";
  /** The trip that the view was fitted to; a reader who moved the map since is left alone. */
  #fitted = "";

  connectedCallback() {
    whenSeen(this, async () => {
      this.#map = await makeMap(this, "track", () => ({ track: this.#lines(), ends: this.#ends(), cursor: [] }));
      this.#map.on("mousemove", "track-edge", (event) => this.#point(event.lngLat.lng, event.lngLat.lat));
      document.addEventListener("scatola:parts", this.#update);
      document.addEventListener("scatola:cursor", ({ detail: { at } }) => {
        const k = at === null ? -1 : this.#at.findIndex((t) => t >= at), place = this.#points[k];
        this.dataset.cursor = place ? String(k) : "";
        put(this.#map, "cursor", place ? [feature("Point", place)] : []);
      });
      void this.#update();
    });
  }

  /** Pieces of one speed, a metre a second wide: a line has one colour. */
  #lines() {
    const features = [];
    for (let i = 0; i + 1 < this.#points.length;) {
      const v = Math.round(this.#speed[i + 1] ?? -1);
      let j = i + 1;
      while (j + 1 < this.#points.length && Math.round(this.#speed[j + 1] ?? -1) === v) j++;
      features.push(feature("LineString", this.#points.slice(i, j + 1), { v }));
      i = j;
    }
    return features;
  }

  #ends() {
    const [first] = this.#points, last = this.#points.at(-1);
    if (first && last) return [feature("Point", first, { end: "start", say: t("start") }), feature("Point", last, { end: "end", say: t("end") })];
    return this.#place ? [feature("Point", this.#place, { end: "end", say: t("last position") })] : [];
  }

  #draw() {
    put(this.#map, "track", this.#lines());
    put(this.#map, "ends", this.#ends());
    this.querySelector(".speed-key")?.toggleAttribute("hidden", this.#points.length < 2);
  }

  /** The instant at which the vehicle was here. @param {number} lon @param {number} lat */
  #point(lon, lat) {
    const shrink = Math.cos((lat * Math.PI) / 180);
    const far = this.#points.map(([x, y]) => ((x - lon) * shrink) ** 2 + (y - lat) ** 2);
    const at = this.#at[far.indexOf(Math.min(...far))];
    if (at !== undefined) document.dispatchEvent(new CustomEvent("scatola:place", { detail: { at } }));
  }

  /** @param {string} lat @param {string} lon */
  #stand(lat, lon) {
    note(this, t("Not yet: no trip to show"));
    const key = `${lat} ${lon}`;
    if (!this.#map || !lat || key === this.#drawn) return;
    this.#drawn = key;
    this.#place = [Number(lon), Number(lat)];
    this.dataset.place = key;
    this.#draw();
    if (this.#fitted !== "place") { this.#fitted = "place"; fit(this.#map, [this.#place], 13); }
  }

  #update = async () => {
    const { track = "", to = "", lat = "", lon = "" } = told(this.getAttribute("last"));
    const key = `${track} ${to}`;
    if (!track) { this.#stand(lat, lon); return; }
    if (key === this.#drawn) return;
    this.#drawn = key;
    const response = await fetched(track).catch(() => undefined);
    if (key !== this.#drawn) return;  // another trip was chosen meanwhile
    if (!response) { note(this, t("The track could not be read")); this.#drawn = ""; return; }
    const { geometry, properties } = /** @type {Track} */ (await response.json());
    this.#points = geometry?.coordinates ?? [];
    this.#at = properties.at.map((at) => Date.parse(at) / 1000);
    this.#speed = properties.speed_mps;
    if (!this.#points.length) { this.#stand(lat, lon); note(this, t("No positions of this trip")); return; }
    note(this, "");
    this.#draw();
    this.dataset.points = String(this.#points.length);
    if (this.#map && this.#fitted !== track) { this.#fitted = track; fit(this.#map, this.#points, 16); }
  };
}

customElements.define("track-map", TrackMap);
