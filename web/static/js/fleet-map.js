// <fleet-map tiles="" pmtiles="">: every box of the list with a position is a mark; colour and shape say the state.
// Positions move with the live stream, a crowd of them at a time; states and filters come from /fleet/places.

import { Popup } from "../vendor/maplibre-gl/maplibre-gl.mjs";
import { feature, fit, makeMap, note, put } from "./basemap.js";
import { fetched, gathered, make } from "./page.js";
import { colour } from "./palette.js";
import { t } from "./words.js";

const SIZE = 22;
const BATCH_MS = 500;

/** Outline of each state in a square of SIZE, the worst last. @type {Record<string, string>} */
const SHAPES = {
  good: "M4 11a7 7 0 1 0 14 0a7 7 0 1 0 -14 0z",
  unknown: "M5 11a6 6 0 1 0 12 0a6 6 0 1 0 -12 0z",
  attention: "M11 3l8.5 15h-17z",
  alarm: "M11 2l9 9l-9 9l-9 -9z",
};
const STATES = Object.keys(SHAPES);

class FleetMap extends HTMLElement {
  /** @type {MapView | undefined} */ #map;
  /** By id. @type {Map<string, Spot>} */ #places = new Map();
  /** What the view was fitted to, unless the reader moved it. */ #fitted = ""; #touched = false;
  #asked = 0;

  async connectedCallback() {
    const map = (this.#map = await makeMap(this, "fleet", () => ({ boxes: this.#features() })));
    map.setMissingStyleImageResolver(async (state) => { if (!map.hasImage(state)) map.addImage(state, mark(state), { pixelRatio: 2 }); });
    const popup = new Popup({ closeButton: false, closeOnClick: false, offset: 14 });
    map.on("mousemove", "boxes", ({ features, lngLat }) => {
      const { name, words } = features?.[0]?.properties ?? {};
      popup.setLngLat(lngLat).setDOMContent(make("div", "", make("b", "", name), words)).addTo(map);
      map.getCanvas().style.cursor = "pointer";
    });
    map.on("mouseleave", "boxes", () => { popup.remove(); map.getCanvas().style.cursor = ""; });
    map.on("click", "boxes", (event) => { location.href = event.features?.[0]?.properties.url; });
    map.on("click", "crowds", (event) => map.easeTo({ center: event.lngLat, zoom: map.getZoom() + 2 }));
    map.on("movestart", (event) => { if (event.originalEvent) this.#touched = true; });
    document.addEventListener("scatola:parts", this.#ask);
    const drawSoon = gathered(BATCH_MS, () => this.#draw());
    // A box that moves is moved here at once.
    document.addEventListener("scatola:change", ({ detail: { kind, device_id: id, lat_deg: lat, lon_deg: lon } }) => {
      const place = this.#places.get(id ?? "");
      if (kind !== "position" || !place || typeof lat !== "number" || typeof lon !== "number") return;
      [place[5], place[6]] = [lat, lon];
      drawSoon();
    });
    void this.#ask();
  }

  #features() {
    return [...this.#places.values()].map(([, url, name, mark, words, lat, lon]) => feature("Point", [lon, lat], { url, name, mark, words, rank: STATES.indexOf(mark) }));
  }

  #ask = async () => {
    const asked = ++this.#asked;
    const answer = await fetched(`/fleet/places${location.search}`).catch(() => undefined);
    if (asked !== this.#asked) return;  // a later question is on its way
    if (!answer) { note(this, t("The positions could not be read")); return; }
    /** @type {Spot[]} */
    const places = await answer.json();
    this.#places = new Map(places.map((place) => [place[0], place]));
    this.#draw();
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

/** The mark of a state, at twice its size for sharp screens. @param {string} state */
function mark(state) {
  const c = /** @type {OffscreenCanvasRenderingContext2D} */ (new OffscreenCanvas(2 * SIZE, 2 * SIZE).getContext("2d"));
  const outline = new Path2D(SHAPES[state]), ring = state === "unknown";
  c.scale(2, 2);
  c.lineJoin = "round";
  c.lineWidth = ring ? 7 : 3;
  c.strokeStyle = colour("card");
  c.stroke(outline);
  c.lineWidth = 3.5;
  c.fillStyle = c.strokeStyle = colour(`${state}-fill`);
  if (ring) c.stroke(outline);
  else c.fill(outline);
  return c.getImageData(0, 0, 2 * SIZE, 2 * SIZE);
}

customElements.define("fleet-map", FleetMap);
