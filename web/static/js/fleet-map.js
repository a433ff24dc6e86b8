// <fleet-map tiles="" pmtiles="">: every box of the list with a position is a mark; colour and shape say the state.
// Positions move with the live stream, a crowd of them at a time; states and filters come from /fleet/places.

import { Popup } from "../vendor/maplibre-gl/maplibre-gl.mjs";
import { feature, fit, makeMap, note, put } from "./basemap.js";
import { fetched, gathered, make } from "./page.js";
import { t } from "./words.js";

const BATCH_MS = 500;
/** Layers that show single boxes. */
const BOXES = ["boxes", "worse"];

class FleetMap extends HTMLElement {
  /** @type {MapView | undefined} */ #map;
  /** By id. @type {Map<string, Spot>} */ #places = new Map();
  /** What the view was fitted to, unless the reader moved it. */ #fitted = ""; #touched = false;
  #asked = 0;

  async connectedCallback() {
    const map = (this.#map = await makeMap(this, "fleet", () => ({ boxes: this.#features() })));
    const popup = new Popup({ closeButton: false, closeOnClick: false, offset: 14 });
    map.on("mousemove", BOXES, ({ features, lngLat }) => {
      const { name, words } = features?.[0]?.properties ?? {};
      popup.setLngLat(lngLat).setDOMContent(make("div", "", make("b", "", name), words)).addTo(map);
      map.getCanvas().style.cursor = "pointer";
    });
    map.on("mouseleave", BOXES, () => { popup.remove(); map.getCanvas().style.cursor = ""; });
    map.on("click", BOXES, (event) => { location.href = event.features?.[0]?.properties.url; });
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
    return [...this.#places.values()].map(([, url, name, mark, words, lat, lon]) => feature("Point", [lon, lat], { url, name, mark, words }));
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

customElements.define("fleet-map", FleetMap);
