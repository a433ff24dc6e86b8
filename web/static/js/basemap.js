// The ground that both maps stand on: bundled land, borders and names, a metric grid at street
// zoom, and the operator's own tiles when there are any.  Nothing is asked of another host unless
// the operator set one; labels use the reader's own fonts, so no glyph server is needed.

import * as maplibre from "../vendor/maplibre-gl/maplibre-gl.mjs";
import { colour } from "./palette.js";

const WORLD = "/static/vendor/world-atlas";
const GRID_FROM_ZOOM = 10;
const METRES_PER_DEGREE = 111_320;

let registered = false;

/** The operator's archive of tiles as a source and layers: pictures, or shapes by the Protomaps schema. @param {string} address */
async function archive(address) {
  const { PMTiles, Protocol } = await import("../vendor/pmtiles/pmtiles.mjs");
  if (!registered) maplibre.addProtocol("pmtiles", new Protocol().tile);
  registered = true;
  const url = new URL(address, location.href).href;
  const shapes = (await new PMTiles(url).getHeader()).tileType === 1;
  const drawn = shapes ? await (await fetch("/static/map/protomaps.json")).text() : '[{"id":"tiles","type":"raster"}]';
  const layers = JSON.parse(drawn.replace(/"@([\w-]+)"/g, (_, name) => JSON.stringify(colour(name))));
  return {
    source: { type: shapes ? "vector" : "raster", url: `pmtiles://${url}`, ...(!shapes && { tileSize: 256 }) },
    layers: layers.map((/** @type {object} */ layer) => ({ ...layer, source: "tiles" })),
  };
}

/** @param {string} tiles template of the operator's raster tiles, or empty @param {{source: object, layers: object[]} | undefined} more @returns {MapStyle} */
function style(tiles, more) {
  const [sea, land, border, ink, grid] = ["sea", "land", "border", "map-ink", "grid"].map(colour);
  return /** @type {MapStyle} */ ({
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

/** Lines a round number of metres apart over what is in view. @param {MapView} map */
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
 * @param {HTMLElement} host with the operator's `tiles` or `pmtiles` @param {(map: MapView) => void} dress
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
  const drawGrid = () => put(map, "grid", metricGrid(map));
  map.on("style.load", () => { dress(map); drawGrid(); });
  map.on("moveend", drawGrid);
  map.on("resize", () => frames.get(map)?.());
  map.on("movestart", (event) => { if (event.originalEvent) frames.delete(map); });
  const restyle = async () => {
    if (pmtiles) more = await archive(pmtiles).catch(() => undefined);  // without it the outline stays
    map.setStyle(style(tiles, more), { diff: false });
  };
  if (pmtiles) void restyle();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => void restyle());
  return map;
}

/** How a map's view was framed; a reader who moved it since is left alone. @type {WeakMap<MapView, () => void>} */
const frames = new WeakMap();

/** Show the points, a single one at street zoom, also when the map changes its size. @param {MapView} map @param {[number, number][]} points @param {number} maxZoom */
export function fit(map, points, maxZoom) {
  const [first] = points;
  if (!first) return;
  const bounds = points.reduce((b, p) => b.extend(p), new maplibre.LngLatBounds(first, first));
  const frame = () => { map.fitBounds(bounds, { padding: 56, maxZoom, animate: false }); };
  frame();
  frames.set(map, frame);
}

/** A line of words over a map, or none. @param {HTMLElement} host @param {string} words */
export function note(host, words) {
  let line = host.querySelector(".map-note");
  if (!words) { line?.remove(); return; }
  if (!line) { line = document.createElement("p"); line.className = "map-note"; host.append(line); }
  line.textContent = words;
}

const SIDES = /** @type {const} */ (["right", "left"]);

/** Named points over everything else. @param {MapView} map @param {string} id @param {GeoJSON.FeatureCollection} data @param {any} fill by the feature @param {string} edge @param {boolean} aside words rather to the sides than above and below */
export function namedPoints(map, id, data, fill, edge, aside = false) {
  map.addSource(id, { type: "geojson", data });
  map.addLayer({ id, type: "circle", source: id, paint: { "circle-radius": 6, "circle-stroke-width": 2.5, "circle-stroke-color": edge, "circle-color": fill } });
  map.addLayer({
    id: `${id}-words`, type: "symbol", source: id,
    // Where points lie close together, their words go to different sides.
    layout: { "text-field": ["get", "say"], "text-size": 12, "text-variable-anchor": [...(aside ? SIDES : []), "top", "bottom", ...(aside ? [] : SIDES), "top-right", "bottom-left"], "text-radial-offset": 0.9, "text-justify": "auto" },
    paint: { "text-color": colour("ink"), "text-halo-color": colour("card"), "text-halo-width": 1.5 },
  });
}

/** Other data for a source. @param {MapView | undefined} map @param {string} id @param {GeoJSON.FeatureCollection} data */
export function put(map, id, data) {
  const source = map?.getSource(id);
  if (source instanceof maplibre.GeoJSONSource) source.setData(data);
}

export const ROUND = /** @type {const} */ ({ "line-cap": "round", "line-join": "round" });
