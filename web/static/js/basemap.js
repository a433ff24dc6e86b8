// The ground that both maps stand on: bundled land, borders and names, a metric grid at street
// zoom, and the operator's own tiles when there are any.  Nothing is asked of another host unless
// the operator set one; labels use the reader's own fonts, so no glyph server is needed.

import * as maplibre from "../vendor/maplibre-gl/maplibre-gl.mjs";
import { colour } from "./palette.js";

/** @typedef {import("../vendor/maplibre-gl/maplibre-gl.mjs").StyleSpecification} Style */
/** @typedef {import("../vendor/maplibre-gl/maplibre-gl.mjs").Map} Map */

const WORLD = "/static/vendor/world-atlas";
const GRID_FROM_ZOOM = 10;
const METRES_PER_DEGREE = 111_320;

/** @typedef {{tiles: string, pmtiles: string}} Ground */
let registered = false;

/** The operator's archive of tiles as sources and layers: pictures, or shapes by the Protomaps schema. @param {string} url */
async function archive(url) {
  const { PMTiles, Protocol } = await import("../vendor/pmtiles/pmtiles.mjs");
  if (!registered) { registered = true; maplibre.addProtocol("pmtiles", new Protocol().tile); }
  const shapes = (await new PMTiles(new URL(url, location.href).href).getHeader()).tileType === 1;
  const source = { type: shapes ? "vector" : "raster", url: `pmtiles://${new URL(url, location.href).href}`, ...(!shapes && { tileSize: 256 }) };
  if (!shapes) return { source, layers: [{ id: "tiles", type: "raster", source: "tiles" }] };
  const layer = (/** @type {string} */ name, /** @type {string} */ type, /** @type {object} */ paint, /** @type {object} */ more = {}) => ({ id: `pm-${name}`, type, source: "tiles", "source-layer": name, paint, ...more });
  const line = colour("border"), ink = colour("map-ink"), land = colour("land");
  return { source, layers: [
    layer("earth", "fill", { "fill-color": land }),
    layer("water", "fill", { "fill-color": colour("sea") }),
    layer("buildings", "fill", { "fill-color": line, "fill-opacity": 0.35 }),
    layer("roads", "line", { "line-color": line, "line-width": ["interpolate", ["exponential", 1.6], ["zoom"], 6, 0.4, 18, 12] }),
    layer("boundaries", "line", { "line-color": line, "line-dasharray": [3, 2] }),
    layer("places", "symbol", { "text-color": ink, "text-halo-color": land, "text-halo-width": 1.2 }, { layout: { "text-field": ["get", "name"], "text-size": 12 } }),
  ] };
}

/** @param {string} tiles template of the operator's raster tiles, or empty @param {{source: object, layers: object[]} | undefined} more @returns {Style} */
function style(tiles, more) {
  const [sea, land, border, ink, grid] = ["sea", "land", "border", "map-ink", "grid"].map(colour);
  return /** @type {Style} */ ({
    version: 8,
    sources: {
      land: { type: "geojson", data: `${WORLD}/land.geojson` },
      borders: { type: "geojson", data: `${WORLD}/borders.geojson` },
      names: { type: "geojson", data: `${WORLD}/names.geojson` },
      grid: { type: "geojson", data: collection([]) },
      ...(more ? { tiles: more.source } : tiles && { tiles: { type: "raster", tiles: [tiles], tileSize: 256 } }),
    },
    layers: [
      { id: "sea", type: "background", paint: { "background-color": sea } },
      { id: "land", type: "fill", source: "land", paint: { "fill-color": land } },
      { id: "coast", type: "line", source: "land", paint: { "line-color": border, "line-width": 0.7 } },
      { id: "borders", type: "line", source: "borders", paint: { "line-color": border, "line-width": 0.8, "line-dasharray": [3, 2] } },
      ...(more ? more.layers : tiles ? [{ id: "tiles", type: "raster", source: "tiles" }] : []),
      { id: "grid", type: "line", source: "grid", minzoom: GRID_FROM_ZOOM, paint: { "line-color": grid, "line-width": 1 } },
      {
        id: "names", type: "symbol", source: "names", maxzoom: 9,
        layout: { "text-field": ["get", "name"], "text-size": 11, "symbol-sort-key": ["-", 0, ["get", "rank"]], "text-max-width": 8 },
        paint: { "text-color": ink, "text-halo-color": land, "text-halo-width": 1.2 },
      },
    ],
  });
}

/** @param {object[]} features */
export function collection(features) {
  return /** @type {GeoJSON.FeatureCollection} */ ({ type: "FeatureCollection", features });
}

/** Lines a round number of metres apart over what is in view. @param {Map} map */
function metricGrid(map) {
  if (map.getZoom() < GRID_FROM_ZOOM) return collection([]);
  const bounds = map.getBounds();
  const [west, south, east, north] = [bounds.getWest(), bounds.getSouth(), bounds.getEast(), bounds.getNorth()];
  const rough = ((north - south) * METRES_PER_DEGREE) / 5;
  const decade = 10 ** Math.floor(Math.log10(rough));
  const metres = decade * (rough / decade >= 5 ? 5 : rough / decade >= 2 ? 2 : 1);
  const dLat = metres / METRES_PER_DEGREE;
  // The step in longitude is fixed on a coarse band of latitude, so that lines do not creep while panning.
  const band = Math.round((south + north) / 2);
  const dLon = dLat / Math.max(Math.cos((band * Math.PI) / 180), 0.05);
  const lines = [];
  for (let k = Math.floor(south / dLat); k * dLat <= north; k++) lines.push([[west, k * dLat], [east, k * dLat]]);
  for (let k = Math.floor(west / dLon); k * dLon <= east; k++) lines.push([[k * dLon, south], [k * dLon, north]]);
  return collection([{ type: "Feature", properties: {}, geometry: { type: "MultiLineString", coordinates: lines } }]);
}

/**
 * A map in an element.  `dress` adds own sources and layers; it runs again when the colour scheme changes.
 * @param {HTMLElement} host with the operator's `tiles` or `pmtiles` @param {(map: Map) => void} dress
 */
export function makeMap(host, dress) {
  const tiles = host.getAttribute("tiles") ?? "", pmtiles = host.getAttribute("pmtiles") ?? "";
  /** @type {Awaited<ReturnType<typeof archive>> | undefined} */ let more;
  const container = document.createElement("div");
  host.append(container);
  const map = new maplibre.Map({
    container, style: style(tiles, more), center: [12, 44], zoom: 3, maxZoom: 18,
    attributionControl: tiles || pmtiles ? { compact: true } : false, dragRotate: false, pitchWithRotate: false, fadeDuration: 0,
  });
  map.touchZoomRotate.disableRotation();
  map.addControl(new maplibre.NavigationControl({ showCompass: false }), "top-right");
  map.addControl(new maplibre.ScaleControl({ unit: "metric" }), "bottom-right");
  const drawGrid = () => {
    const source = map.getSource("grid");
    if (source instanceof maplibre.GeoJSONSource) source.setData(metricGrid(map));
  };
  map.on("style.load", () => { dress(map); drawGrid(); });
  map.on("moveend", drawGrid);
  const restyle = async () => {
    if (pmtiles) more = await archive(pmtiles).catch(() => undefined);  // without it the outline stays
    map.setStyle(style(tiles, more), { diff: false });
  };
  if (pmtiles) void restyle();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => void restyle());
  return map;
}

/** Show the points, a single one at street zoom. @param {Map} map @param {[number, number][]} points @param {number} maxZoom */
export function fit(map, points, maxZoom) {
  const [first] = points;
  if (!first) return;
  const bounds = points.reduce((b, p) => b.extend(p), new maplibre.LngLatBounds(first, first));
  map.fitBounds(bounds, { padding: 56, maxZoom, animate: false });
}

/** A canvas to draw an icon on, at twice the size. @param {number} size @param {(c: CanvasRenderingContext2D, s: number) => void} draw */
export function icon(size, draw) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = size * 2;
  const context = canvas.getContext("2d");
  if (!context) throw new Error("no 2D canvas");
  context.scale(2, 2);
  draw(context, size);
  return context.getImageData(0, 0, size * 2, size * 2);
}

/** A line of words over a map, or none. @param {HTMLElement} host @param {string} words */
export function note(host, words) {
  let line = host.querySelector(".map-note");
  if (!words) { line?.remove(); return; }
  if (!line) { line = document.createElement("p"); line.className = "map-note"; host.append(line); }
  line.textContent = words;
}
