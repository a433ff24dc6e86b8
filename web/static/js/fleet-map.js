// <fleet-map tiles="" pmtiles="">: every box of the list with a position is a mark; colour and shape say the state.
// Positions move with the live stream, a crowd of them at a time; states and filters come from /fleet/places.

import { Popup } from "../vendor/maplibre-gl/maplibre-gl.mjs";
import { GroundMap, feature } from "./basemap.js";
import { gathered, hear, make, read } from "./page.js";
import { t } from "./words.js";

const BATCH_MS = 500, BOXES = ["boxes", "worse"];

class FleetMap extends GroundMap {
  /** By id. @type {Map<string, Feature>} */ #places = new Map();
  #asked = 0;

  async connectedCallback() {
    const map = await this.open("fleet", () => ({ boxes: [...this.#places.values()] }));
    const popup = new Popup({ closeButton: false, closeOnClick: false, offset: 14 });
    map.on("mousemove", BOXES, ({ features, lngLat }) => {
      const { name, words } = features?.[0]?.properties ?? {};
      popup.setLngLat(lngLat).setDOMContent(make("div", make("b", name), words)).addTo(map);
      map.getCanvas().style.cursor = "pointer";
    });
    map.on("mouseleave", BOXES, () => { popup.remove(); map.getCanvas().style.cursor = ""; });
    map.on("click", BOXES, (event) => { location.href = event.features?.[0]?.properties.url; });
    map.on("click", "crowds", (event) => map.easeTo({ center: event.lngLat, zoom: map.getZoom() + 2 }));
    hear("parts", () => void this.#ask());
    const drawSoon = gathered(BATCH_MS, () => this.#draw());
    // A box that moves is moved here at once.
    hear("change", ({ kind, device_id: id, lat_deg: lat, lon_deg: lon }) => {
      const place = this.#places.get(id ?? "");
      if (kind !== "position" || !place || lat == null || lon == null) return;
      place.geometry.coordinates = [lon, lat];
      drawSoon();
    });
    void this.#ask();
  }

  async #ask() {
    const asked = ++this.#asked;
    /** @type {Spot[] | undefined} */
    const places = await read(`/fleet/places${location.search}`).catch(() => undefined);
    if (asked !== this.#asked) return;  // a later question is on its way
    if (!places) { this.note(t("The positions could not be read")); return; }
    this.#places = new Map(places.map(([id, url, name, mark, words, lat, lon]) => [id, feature("Point", [lon, lat], { url, name, mark, words })]));
    this.#draw();
  }

  #draw() {
    const boxes = [...this.#places.values()];
    this.put({ boxes });
    this.dataset.marks = String(boxes.length);
    if (!this.touched) this.fit([...this.#places.keys()].sort().join(), boxes.map(({ geometry }) => geometry.coordinates), 13);
    this.note(this.#places.size ? "" : t("No box of this list has a position yet"));
  }
}

customElements.define("fleet-map", FleetMap);
