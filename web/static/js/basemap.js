// The ground that all maps stand on: bundled land, borders and names, a metric grid at street zoom, the operator's own
// tiles if any; /static/map has the styles.  No other host is asked unless the operator set one, and none for glyphs.

import * as maplibre from "../vendor/maplibre-gl/maplibre-gl.mjs";
import { colour, dark, fetched, make } from "./page.js";
import { UNITS, t } from "./words.js";

export const METRES_PER_DEGREE = 111_320;
/** Tiles that are pictures. @type {Pictures} */
const pictures = (where) => ({ source: { type: "raster", tileSize: 256, ...where }, layers: [{ id: "tiles", type: "raster", source: "tiles" }] });

/** A file of the site's map styles, with the reader's colours where it names them. @type {Fetched<any>} */
const drawn = async (name) => {
  const written = await (await fetched(`/static/map/${name}.json`)).text();
  return JSON.parse(written.replace(/"@([\w-]+)"/g, (_, variable) => JSON.stringify(colour(variable))));
};

/** The operator's archive of tiles: pictures, or shapes by the Protomaps schema. @type {Fetched<Tiles>} */
const archive = async (address) => {
  const { PMTiles, Protocol } = await import("../vendor/pmtiles/pmtiles.mjs");
  maplibre.addProtocol("pmtiles", new Protocol().tile);
  const file = new URL(address, location.href).href, url = `pmtiles://${file}`;
  const shapes = (await new PMTiles(file).getHeader()).tileType === 1;
  return shapes ? { source: { type: "vector", url }, layers: await drawn("protomaps") } : pictures({ url });
};

/** The bundled ground, the operator's tiles below its grid and names, over all what the style `name` adds. @param {string} name @param {Tiles} [tiles] */
async function styled(name, tiles) {
  const [ground, own] = /** @type {[MapStyle, MapStyle]} */ (await Promise.all([drawn("ground"), drawn(name)]));
  const grid = ground.layers.findIndex(({ id }) => id === "grid");
  return {
    ...ground, sources: { ...ground.sources, ...own.sources, ...(tiles && { tiles: tiles.source }) },
    layers: [...ground.layers.slice(0, grid), ...(tiles?.layers ?? []), ...ground.layers.slice(grid), ...own.layers],
  };
}

/** @type {MakeFeature} */
export const feature = (type, coordinates, properties = {}) => ({ type: "Feature", properties, geometry: { type, coordinates } });

/** Lines a round number of metres apart over what is in view. @param {MapView} map */
function metricGrid(map) {
  if (map.getZoom() < (map.getLayer("grid")?.minzoom ?? 0)) return [];
  const [[west, south], [east, north]] = map.getBounds().toArray();
  const rough = ((north - south) * METRES_PER_DEGREE) / 5, decade = 10 ** Math.floor(Math.log10(rough));
  const metres = decade * ([5, 2].find((n) => rough / decade >= n) ?? 1), dLat = metres / METRES_PER_DEGREE;
  // The step in longitude is fixed on a coarse band of latitude, so that lines do not creep while panning.
  const band = Math.round((south + north) / 2);
  const dLon = dLat / Math.max(Math.cos((band * Math.PI) / 180), 0.05);
  const lines = [];
  for (let k = Math.floor(south / dLat); k * dLat <= north; k++) lines.push([[west, k * dLat], [east, k * dLat]]);
  for (let k = Math.floor(west / dLon); k * dLon <= east; k++) lines.push([[k * dLon, south], [k * dLon, north]]);
  return [feature("MultiLineString", lines)];
}

/** An element with a map of its own style; with the operator's `tiles` or `pmtiles`, and a line of words over it. */
export class GroundMap extends HTMLElement {
  /** @type {MapView | undefined} */ map;
  /** Whether the reader moved it. */ touched = false;
  #fitted = "";
  #frame = () => {};

  /** The map, by the style `name`; read again when the colour scheme changes. @param {string} name @param {Sources} sources */
  async open(name, sources) {
    const address = this.getAttribute("tiles"), file = this.getAttribute("pmtiles");
    let tiles = address ? pictures({ tiles: [address] }) : undefined;
    const container = make("div");
    this.append(container);
    const map = (this.map = new maplibre.Map({
      container, style: await styled(name, tiles), center: [12, 44], zoom: 3, maxZoom: 18,
      attributionControl: address || file ? { compact: true } : false, locale: { "Map.Title": t("Map"), "NavigationControl.ZoomIn": t("Zoom in"), "NavigationControl.ZoomOut": t("Zoom out") }, dragRotate: false, fadeDuration: 0,
    }));
    map.touchZoomRotate.disableRotation();
    map.addControl(new maplibre.NavigationControl({ showCompass: false }), "top-right");
    map.addControl(new maplibre.ScaleControl({ unit: UNITS }), "bottom-right");
    const drawGrid = () => this.put({ grid: metricGrid(map) });
    map.on("style.load", () => { this.put(sources()); drawGrid(); });
    map.on("moveend", drawGrid);
    map.on("resize", () => { if (!this.touched) this.#frame(); });
    map.on("movestart", (event) => { this.touched ||= !!event.originalEvent; });
    const restyle = async () => {
      if (file) tiles = await archive(file).catch(() => tiles);  // without it the outline stays
      map.setStyle(await styled(name, tiles), { diff: false });
    };
    if (file) void restyle();
    dark.addEventListener("change", () => void restyle());
    return map;
  }

  /** Other data for sources. @param {Record<string, Feature[]>} sources */
  put(sources) {
    for (const [id, features] of Object.entries(sources)) {
      const source = this.map?.getSource(id);
      if (source instanceof maplibre.GeoJSONSource) source.setData({ type: "FeatureCollection", features });
    }
  }

  /** Show the points, a single one at street zoom, also when the map changes its size; once for each `what`. @param {string} what @param {LonLat[]} points @param {number} maxZoom */
  fit(what, points, maxZoom) {
    const [first] = points, { map } = this;
    if (!first || !map || what === this.#fitted) return;
    this.#fitted = what;
    this.touched = false;
    const bounds = points.reduce((b, p) => b.extend(p), new maplibre.LngLatBounds(first, first));
    this.#frame = () => { map.fitBounds(bounds, { padding: 56, maxZoom, animate: false }); };
    this.#frame();
  }

  /** A line of words over the map, or none. @param {string} words */
  note(words) {
    const line = this.querySelector(".map-note");
    if (line) line.textContent = words;
    line?.toggleAttribute("hidden", !words);
  }
}
