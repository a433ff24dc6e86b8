// <track-map last="id of the part that names the last trip and position" tiles="">: where the last
// trip went, or where the vehicle stands before the first.

import { GeoJSONSource } from "../vendor/maplibre-gl/maplibre-gl.mjs";
import { collection, fit, makeMap } from "./basemap.js";
import { colour } from "./palette.js";
import { whenSeen } from "./seen.js";

/** @typedef {import("../vendor/maplibre-gl/maplibre-gl.mjs").Map} Map */

class TrackMap extends HTMLElement {
  /** @type {Map | undefined} */ #map;
  #track = collection([]);
  /** Where the vehicle stands, as long as there is no trip. @type {[number, number] | undefined} */ #place;
  /** What is drawn: the trip and how far it had got. */
  #drawn = "";
  /** The trip that the view was fitted to; a reader who moved the map since is left alone. */
  #fitted = "";

  connectedCallback() {
    whenSeen(this, () => {
      this.#map = makeMap(this, this.getAttribute("tiles") ?? "", (map) => this.#dress(map));
      document.addEventListener("scatola:parts", this.#update);
      void this.#update();
    });
  }

  disconnectedCallback() {
    document.removeEventListener("scatola:parts", this.#update);
    this.#map?.remove();
  }

  /** @param {Map} map */
  #dress(map) {
    map.addSource("track", { type: "geojson", data: this.#track });
    map.addSource("ends", { type: "geojson", data: this.#ends() });
    const round = { "line-cap": /** @type {const} */ ("round"), "line-join": /** @type {const} */ ("round") };
    map.addLayer({ id: "track-edge", type: "line", source: "track", layout: round, paint: { "line-color": colour("card"), "line-width": 7 } });
    map.addLayer({ id: "track", type: "line", source: "track", layout: round, paint: { "line-color": colour("track"), "line-width": 3.5 } });
    map.addLayer({
      id: "ends", type: "circle", source: "ends",
      paint: {
        "circle-radius": 6, "circle-stroke-width": 3, "circle-stroke-color": colour("track"),
        "circle-color": ["case", ["==", ["get", "words"], "start"], colour("card"), colour("track")],
      },
    });
    map.addLayer({
      id: "end-words", type: "symbol", source: "ends",
      layout: { "text-field": ["get", "words"], "text-size": 12, "text-anchor": "top", "text-offset": [0, 0.8], "text-allow-overlap": true },
      paint: { "text-color": colour("ink"), "text-halo-color": colour("card"), "text-halo-width": 1.5 },
    });
  }

  #points() {
    return this.#track.features.flatMap((f) => (f.geometry?.type === "LineString" ? /** @type {[number, number][]} */ (f.geometry.coordinates) : []));
  }

  #ends() {
    const points = this.#points();
    const [first] = points, last = points.at(-1);
    const ends = first && last ? [[first, "start"], [last, "end"]] : this.#place ? [[this.#place, "last position"]] : [];
    return collection(ends.map(([coordinates, words]) => (
      { type: "Feature", properties: { words }, geometry: { type: "Point", coordinates } })));
  }

  #draw() {
    for (const [id, data] of /** @type {const} */ ([["track", this.#track], ["ends", this.#ends()]])) {
      const source = this.#map?.getSource(id);
      if (source instanceof GeoJSONSource) source.setData(data);
    }
  }

  /** @param {string} lat @param {string} lon */
  #stand(lat, lon) {
    this.#note("Not yet: no trip to show");
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
    const response = await fetch(track);
    if (!response.ok) { this.#note("The track could not be read"); this.#drawn = ""; return; }
    const answer = /** @type {GeoJSON.FeatureCollection | GeoJSON.Feature} */ (await response.json());
    this.#track = answer.type === "Feature" ? collection([answer]) : answer;
    this.#note("");
    this.#draw();
    const points = this.#points();
    this.dataset.points = String(points.length);
    if (this.#map && this.#fitted !== track && points.length > 0) { this.#fitted = track; fit(this.#map, points, 16); }
  };

  /** @param {string} words */
  #note(words) {
    let note = this.querySelector(".map-note");
    if (!words) { note?.remove(); return; }
    if (!note) { note = document.createElement("p"); note.className = "map-note"; this.append(note); }
    note.textContent = words;
  }
}

customElements.define("track-map", TrackMap);
