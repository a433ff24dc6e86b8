// <track-map last="id of the part that names the trip and position" tiles="" pmtiles="">: where the trip went, coloured
// by speed, or where the vehicle stands before the first.  The charts' cursor is a point on the way.

import { ROUND, collection, fit, makeMap, namedPoints, note, put } from "./basemap.js";
import { colour } from "./palette.js";
import { whenSeen } from "./seen.js";
import { SPEED, t } from "./words.js";

/** Speeds of the colours, m/s: standing, town, country road, motorway. */
const RAMP = /** @type {const} */ ([[0, "#3b6fd4"], [14, "#22a884"], [25, "#e6b422"], [36, "#d93a3a"]]);

class TrackMap extends HTMLElement {
  /** @type {MapView | undefined} */ #map;
  /** @type {[number, number][]} */ #points = [];
  /** Unix seconds of each point. @type {number[]} */ #at = [];
  /** @type {(number | null)[]} */ #speed = [];
  /** Where the vehicle stands, as long as there is no trip. @type {[number, number] | undefined} */ #place;
  /** What is drawn: the trip and how far it had got. */
  #drawn = "";
  /** The trip that the view was fitted to; a reader who moved the map since is left alone. */
  #fitted = "";

  connectedCallback() {
    whenSeen(this, () => {
      this.#map = makeMap(this, (map) => this.#dress(map));
      this.#map.on("mousemove", "track-edge", (event) => this.#point(event.lngLat.lng, event.lngLat.lat));
      document.addEventListener("scatola:parts", this.#update);
      document.addEventListener("scatola:cursor", this.#onCursor);
      void this.#update();
    });
  }

  /** @param {MapView} map */
  #dress(map) {
    map.addSource("track", { type: "geojson", data: this.#lines() });
    map.addSource("cursor", { type: "geojson", data: collection([]) });
    map.addLayer({ id: "track-edge", type: "line", source: "track", layout: ROUND, paint: { "line-color": colour("card"), "line-width": 8 } });
    map.addLayer({
      id: "track", type: "line", source: "track", layout: ROUND,
      paint: { "line-width": 4, "line-color": ["case", ["<", ["get", "v"], 0], colour("unknown-fill"), ["interpolate", ["linear"], ["get", "v"], ...RAMP.flat()]] },
    });
    namedPoints(map, "ends", this.#ends(), ["case", ["==", ["get", "end"], "start"], colour("card"), colour("ink")], colour("ink"));
    map.addLayer({ id: "cursor", type: "circle", source: "cursor", paint: { "circle-radius": 7, "circle-color": colour("accent"), "circle-stroke-width": 3, "circle-stroke-color": colour("card") } });
  }

  /** Pieces of one speed, a metre a second wide: a line has one colour. */
  #lines() {
    const features = [];
    for (let i = 0; i + 1 < this.#points.length;) {
      const v = Math.round(this.#speed[i + 1] ?? -1);
      let j = i + 1;
      while (j + 1 < this.#points.length && Math.round(this.#speed[j + 1] ?? -1) === v) j++;
      features.push({ type: "Feature", properties: { v }, geometry: { type: "LineString", coordinates: this.#points.slice(i, j + 1) } });
      i = j;
    }
    return collection(features);
  }

  #ends() {
    const [first] = this.#points, last = this.#points.at(-1);
    const ends = first && last ? [[first, "start", t("start")], [last, "end", t("end")]] : this.#place ? [[this.#place, "end", t("last position")]] : [];
    return collection(ends.map(([coordinates, end, say]) => (
      { type: "Feature", properties: { end, say }, geometry: { type: "Point", coordinates } })));
  }

  #draw() {
    put(this.#map, "track", this.#lines());
    put(this.#map, "ends", this.#ends());
    this.querySelector(".speed-key")?.remove();
    if (this.#points.length < 2) return;
    const key = document.createElement("div");
    key.className = "speed-key";
    key.innerHTML = `<div class="speed-ramp"></div><div class="speed-ends"><span>0</span><span>${Math.round(RAMP[3][0] * SPEED.perMps)} ${SPEED.unit}</span></div>`;
    this.append(key);
  }

  /** The instant under the charts' cursor. @param {Event} event */
  #onCursor = (event) => {
    const at = /** @type {CustomEvent<{at: number | null}>} */ (event).detail.at;
    const k = at === null ? -1 : this.#at.findIndex((t) => t >= at);
    const coordinates = this.#points[k];
    this.dataset.cursor = coordinates ? String(k) : "";
    put(this.#map, "cursor", collection(coordinates ? [{ type: "Feature", properties: {}, geometry: { type: "Point", coordinates } }] : []));
  };

  /** The other way: the instant at which the vehicle was here. @param {number} lon @param {number} lat */
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
    const { track = "", to = "", lat = "", lon = "" } = document.getElementById(this.getAttribute("last") ?? "")?.dataset ?? {};
    const key = `${track} ${to}`;
    if (!track) { this.#stand(lat, lon); return; }
    if (key === this.#drawn) return;
    this.#drawn = key;
    const response = await fetch(track).catch(() => undefined);
    if (key !== this.#drawn) return;  // another trip was chosen meanwhile
    if (!response?.ok) { note(this, t("The track could not be read")); this.#drawn = ""; return; }
    const { geometry, properties } = /** @type {Track} */ (await response.json());
    this.#points = geometry?.coordinates ?? [];
    this.#at = properties.at.map((at) => Date.parse(at) / 1000);
    this.#speed = properties.speed_mps;
    if (!this.#points.length) { this.#stand(lat, lon); note(this, t("No positions of this trip")); return; }
    note(this, "");
    this.#draw();
    this.dataset.points = String(this.#points.length);
    if (this.#map && this.#fitted !== track && this.#points.length > 0) { this.#fitted = track; fit(this.#map, this.#points, 16); }
  };
}

customElements.define("track-map", TrackMap);
