// <fleet-map rows="id of the table" tiles="">: every row with a position is a mark; colour and shape say the state.

import { Popup, GeoJSONSource } from "../vendor/maplibre-gl/maplibre-gl.mjs";
import { collection, fit, icon, makeMap } from "./basemap.js";
import { colour } from "./palette.js";

/** @typedef {import("../vendor/maplibre-gl/maplibre-gl.mjs").Map} Map */
const SIZE = 22;
const TAU = 2 * Math.PI;

/** Outline of a state's shape. @type {Record<string, (c: CanvasRenderingContext2D, m: number) => void>} */
const SHAPES = {
  good: (c, m) => c.arc(m, m, 7, 0, TAU),
  attention: (c, m) => { c.moveTo(m, m - 8); c.lineTo(m + 8.5, m + 7); c.lineTo(m - 8.5, m + 7); c.closePath(); },
  alarm: (c, m) => { c.moveTo(m, m - 9); c.lineTo(m + 9, m); c.lineTo(m, m + 9); c.lineTo(m - 9, m); c.closePath(); },
  unknown: (c, m) => { c.arc(m, m, 6, 0, TAU); },
};

class FleetMap extends HTMLElement {
  /** @type {Map | undefined} */ #map;
  #fitted = false;

  connectedCallback() {
    this.#map = makeMap(this, this.getAttribute("tiles") ?? "", (map) => this.#dress(map));
    const popup = new Popup({ closeButton: false, closeOnClick: false, offset: 14 });
    this.#map.on("mousemove", "boxes", (event) => {
      const feature = event.features?.[0];
      if (!feature) return;
      const words = document.createElement("div");
      const name = document.createElement("b");
      name.textContent = feature.properties.name;
      words.append(name, feature.properties.words);
      popup.setLngLat(event.lngLat).setDOMContent(words).addTo(event.target);
      event.target.getCanvas().style.cursor = "pointer";
    });
    this.#map.on("mouseleave", "boxes", (event) => { popup.remove(); event.target.getCanvas().style.cursor = ""; });
    this.#map.on("click", "boxes", (event) => { location.href = event.features?.[0]?.properties.url; });
    this.#map.on("click", "crowds", (event) => event.target.easeTo({ center: event.lngLat, zoom: event.target.getZoom() + 2 }));
    document.addEventListener("scatola:parts", this.#update);
  }

  disconnectedCallback() {
    document.removeEventListener("scatola:parts", this.#update);
    this.#map?.remove();
  }

  /** @param {Map} map */
  #dress(map) {
    const card = colour("card"), ink = colour("ink");
    for (const [state, outline] of Object.entries(SHAPES)) {
      const image = icon(SIZE, (c, size) => {
        c.beginPath();
        outline(c, size / 2);
        c.lineWidth = state === "unknown" ? 7 : 3;
        c.lineJoin = "round";
        c.strokeStyle = card;
        c.stroke();
        if (state === "unknown") { c.lineWidth = 3.5; c.strokeStyle = colour("unknown-fill"); c.stroke(); }
        else { c.fillStyle = colour(`${state}-fill`); c.fill(); }
      });
      map.addImage(state, image, { pixelRatio: 2 });
    }
    map.addSource("boxes", { type: "geojson", data: this.#features(), cluster: true, clusterRadius: 32, clusterMaxZoom: 13 });
    map.addLayer({
      id: "crowds", type: "circle", source: "boxes", filter: ["has", "point_count"],
      paint: { "circle-color": card, "circle-radius": 14, "circle-stroke-width": 2, "circle-stroke-color": colour("accent") },
    });
    map.addLayer({
      id: "crowd-sizes", type: "symbol", source: "boxes", filter: ["has", "point_count"],
      layout: { "text-field": ["get", "point_count_abbreviated"], "text-size": 13, "text-allow-overlap": true }, paint: { "text-color": ink },
    });
    map.addLayer({
      id: "boxes", type: "symbol", source: "boxes", filter: ["!", ["has", "point_count"]],
      layout: {
        "icon-image": ["get", "mark"], "icon-allow-overlap": true,
        "text-field": ["get", "name"], "text-size": 12, "text-anchor": "top", "text-offset": [0, 0.9], "text-optional": true,
      },
      paint: { "text-color": ink, "text-halo-color": card, "text-halo-width": 1.5 },
    });
    this.#update();
  }

  #features() {
    const rows = document.querySelectorAll(`#${CSS.escape(this.getAttribute("rows") ?? "")} tr[data-lat]`);
    return collection([...rows].map((row) => {
      const { lat, lon, ...properties } = /** @type {HTMLElement} */ (row).dataset;
      return { type: "Feature", properties, geometry: { type: "Point", coordinates: [Number(lon), Number(lat)] } };
    }));
  }

  #update = () => {
    const data = this.#features();
    const source = this.#map?.getSource("boxes");
    if (source instanceof GeoJSONSource) source.setData(data);
    this.dataset.marks = String(data.features.length);
    if (this.#map && !this.#fitted && data.features.length > 0) {
      this.#fitted = true;
      fit(this.#map, data.features.map((f) => /** @type {[number, number]} */ (/** @type {GeoJSON.Point} */ (f.geometry).coordinates)), 13);
    }
    this.#note(data.features.length === 0 ? "No box has a position yet" : "");
  };

  /** @param {string} words */
  #note(words) {
    let note = this.querySelector(".map-note");
    if (!words) { note?.remove(); return; }
    if (!note) { note = document.createElement("p"); note.className = "map-note"; this.append(note); }
    note.textContent = words;
  }
}

customElements.define("fleet-map", FleetMap);
