// <track-map last="id of the part that names the trip and position" tiles="" pmtiles="">: where the trip went, coloured
// by speed, or where the vehicle stands before the first.  The charts' cursor is a point on the way.

import { GeoJSONSource } from "../vendor/maplibre-gl/maplibre-gl.mjs";
import { collection, fit, makeMap, note } from "./basemap.js";
import { colour } from "./palette.js";
import { whenSeen } from "./seen.js";
import { SPEED, t } from "./words.js";

/** @typedef {import("../vendor/maplibre-gl/maplibre-gl.mjs").Map} Map */
/** @typedef {{geometry: {coordinates: [number, number][]} | null, properties: {at: string[], speed_mps: (number | null)[]}}} Track */
/** Speeds of the colours, m/s: standing, town, country road, motorway. */
const RAMP = /** @type {const} */ ([[0, "#3b6fd4"], [14, "#22a884"], [25, "#e6b422"], [36, "#d93a3a"]]);

class TrackMap extends HTMLElement {
  /** @type {Map | undefined} */ #map;
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

  disconnectedCallback() {
    document.removeEventListener("scatola:parts", this.#update);
    document.removeEventListener("scatola:cursor", this.#onCursor);
    this.#map?.remove();
  }

  /** @param {Map} map */
  #dress(map) {
    map.addSource("track", { type: "geojson", data: this.#lines() });
    map.addSource("ends", { type: "geojson", data: this.#ends() });
    map.addSource("cursor", { type: "geojson", data: collection([]) });
    const round = { "line-cap": /** @type {const} */ ("round"), "line-join": /** @type {const} */ ("round") };
    map.addLayer({ id: "track-edge", type: "line", source: "track", layout: round, paint: { "line-color": colour("card"), "line-width": 8 } });
    map.addLayer({
      id: "track", type: "line", source: "track", layout: round,
      paint: { "line-width": 4, "line-color": ["case", ["<", ["get", "v"], 0], colour("unknown-fill"), ["interpolate", ["linear"], ["get", "v"], ...RAMP.flat()]] },
    });
    map.addLayer({
      id: "ends", type: "circle", source: "ends",
      paint: {
        "circle-radius": 6, "circle-stroke-width": 3, "circle-stroke-color": colour("ink"),
        "circle-color": ["case", ["==", ["get", "end"], "start"], colour("card"), colour("ink")],
      },
    });
    map.addLayer({
      id: "end-words", type: "symbol", source: "ends",
      layout: { "text-field": ["get", "words"], "text-size": 12, "text-anchor": "top", "text-offset": [0, 0.8], "text-allow-overlap": true },
      paint: { "text-color": colour("ink"), "text-halo-color": colour("card"), "text-halo-width": 1.5 },
    });
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
    return collection(ends.map(([coordinates, end, words]) => (
      { type: "Feature", properties: { end, words }, geometry: { type: "Point", coordinates } })));
  }

  /** @param {string} id @param {GeoJSON.FeatureCollection} data */
  #set(id, data) {
    const source = this.#map?.getSource(id);
    if (source instanceof GeoJSONSource) source.setData(data);
  }

  #draw() {
    this.#set("track", this.#lines());
    this.#set("ends", this.#ends());
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
    this.#set("cursor", collection(coordinates ? [{ type: "Feature", properties: {}, geometry: { type: "Point", coordinates } }] : []));
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
    note(this, this.#points.length ? "" : t("No positions of this trip"));
    this.#draw();
    this.dataset.points = String(this.#points.length);
    if (this.#map && this.#fitted !== track && this.#points.length > 0) { this.#fitted = track; fit(this.#map, this.#points, 16); }
  };
}

customElements.define("track-map", TrackMap);
