// <fleet-map tiles="" pmtiles="">: every box of the list with a position is a mark; colour and shape say the state.
// Positions move with the live stream, a crowd of them at a time; states and filters come from /fleet/places.

import { Popup } from "../vendor/maplibre-gl/maplibre-gl.mjs";
import { collection, fit, makeMap, note, put } from "./basemap.js";
import { colour } from "./palette.js";
import { t } from "./words.js";

const SIZE = 22;
const TAU = 2 * Math.PI;
const BATCH_MS = 500;
const STATES = ["good", "unknown", "attention", "alarm"];

/** Outline of a state's shape. @type {Record<string, (c: CanvasRenderingContext2D, m: number) => void>} */
const SHAPES = {
  good: (c, m) => c.arc(m, m, 7, 0, TAU),
  attention: (c, m) => { c.moveTo(m, m - 8); c.lineTo(m + 8.5, m + 7); c.lineTo(m - 8.5, m + 7); c.closePath(); },
  alarm: (c, m) => { c.moveTo(m, m - 9); c.lineTo(m + 9, m); c.lineTo(m, m + 9); c.lineTo(m - 9, m); c.closePath(); },
  unknown: (c, m) => { c.arc(m, m, 6, 0, TAU); },
};

class FleetMap extends HTMLElement {
  /** @type {MapView | undefined} */ #map;
  /** By id. @type {Map<string, Spot>} */ #places = new Map();
  /** What the view was fitted to; a reader who moved the map since is left alone. */
  #fitted = "";
  #touched = false;
  /** @type {ReturnType<typeof setTimeout> | undefined} */ #later;
  #asked = 0;

  connectedCallback() {
    this.#map = makeMap(this, (map) => this.#dress(map));
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
    this.#map.on("movestart", (event) => { if (event.originalEvent) this.#touched = true; });
    document.addEventListener("scatola:parts", this.#ask);
    document.addEventListener("scatola:change", this.#onChange);
    void this.#ask();
  }

  /** @param {MapView} map */
  #dress(map) {
    const card = colour("card"), ink = colour("ink");
    for (const [state, outline] of Object.entries(SHAPES)) {
      const c = /** @type {any} */ (new OffscreenCanvas(2 * SIZE, 2 * SIZE).getContext("2d"));
      c.scale(2, 2);
      outline(c, SIZE / 2);
      c.lineWidth = state === "unknown" ? 7 : 3;
      c.lineJoin = "round";
      c.strokeStyle = card;
      c.stroke();
      if (state === "unknown") { c.lineWidth = 3.5; c.strokeStyle = colour("unknown-fill"); c.stroke(); }
      else { c.fillStyle = colour(`${state}-fill`); c.fill(); }
      map.addImage(state, c.getImageData(0, 0, 2 * SIZE, 2 * SIZE), { pixelRatio: 2 });
    }
    map.addSource("boxes", {
      type: "geojson", data: this.#features(), cluster: true, clusterRadius: 36, clusterMaxZoom: 13,
      clusterProperties: { worst: ["max", ["get", "rank"]] },
    });
    map.addLayer({
      id: "crowds", type: "circle", source: "boxes", filter: ["has", "point_count"],
      paint: {
        "circle-color": card, "circle-radius": ["step", ["get", "point_count"], 14, 100, 18, 1000, 22], "circle-stroke-width": 3,
        "circle-stroke-color": ["match", ["get", "worst"], 3, colour("alarm-fill"), 2, colour("attention-fill"), 1, colour("unknown-fill"), colour("good-fill")],
      },
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
  }

  #features() {
    return collection([...this.#places.values()].map(([, url, name, mark, words, lat, lon]) => (
      { type: "Feature", properties: { url, name, mark, words, rank: STATES.indexOf(mark) }, geometry: { type: "Point", coordinates: [lon, lat] } })));
  }

  #ask = async () => {
    const asked = ++this.#asked;
    const answer = await fetch(`/fleet/places${location.search}`).catch(() => undefined);
    if (asked !== this.#asked) return;  // a later question is on its way
    if (!answer?.ok) { note(this, t("The positions could not be read")); return; }
    /** @type {Spot[]} */
    const places = await answer.json();
    this.#places = new Map(places.map((place) => [place[0], place]));
    this.#draw();
  };

  /** A box that moves is moved here at once. @param {Event} event */
  #onChange = (event) => {
    const { kind, device_id: id, lat_deg: lat, lon_deg: lon } = /** @type {CustomEvent} */ (event).detail;
    const place = this.#places.get(id);
    if (kind !== "position" || !place || typeof lat !== "number") return;
    [place[5], place[6]] = [lat, lon];
    this.#later ??= setTimeout(() => { this.#later = undefined; if (!document.hidden) this.#draw(); }, BATCH_MS);
  };

  #draw() {
    put(this.#map, "boxes", this.#features());
    this.dataset.marks = String(this.#places.size);
    const shown = [...this.#places.keys()].sort().join();
    if (this.#map && !this.#touched && shown !== this.#fitted) {
      this.#fitted = shown;
      fit(this.#map, [...this.#places.values()].map(([, , , , , lat, lon]) => [lon, lat]), 13);
    }
    note(this, this.#places.size === 0 ? t("No box of this list has a position yet") : "");
  }
}

customElements.define("fleet-map", FleetMap);
