// The ground that all maps stand on: bundled land, borders and names, a metric grid at street zoom, the operator's own
// tiles if any; /static/map has the styles.  No other host is asked unless the operator set one, and none for glyphs.

import * as maplibre from "../vendor/maplibre-gl/maplibre-gl.mjs";
import { fetched, make } from "./page.js";
import { colour, onScheme } from "./palette.js";
import { UNITS, t } from "./words.js";

export const METRES_PER_DEGREE = 111_320;
/** @type {Layer[]} */
const PICTURES = [{ id: "tiles", type: "raster", source: "tiles" }];

/** A file of the site's map styles, with the reader's colours where it names them. @param {string} name */
async function drawn(name) {
  const written = await (await fetched(`/static/map/${name}.json`)).text();
  return JSON.parse(written.replace(/"@([\w-]+)"/g, (_, variable) => JSON.stringify(colour(variable))));
}

/** The operator's archive of tiles: pictures, or shapes by the Protomaps schema. @param {string} address @returns {Promise<Tiles>} */
async function archive(address) {
  const { PMTiles, Protocol } = await import("../vendor/pmtiles/pmtiles.mjs");
  maplibre.addProtocol("pmtiles", new Protocol().tile);
  const file = new URL(address, location.href).href, url = `pmtiles://${file}`;
  const shapes = (await new PMTiles(file).getHeader()).tileType === 1;
  return shapes ? { source: { type: "vector", url }, layers: await drawn("protomaps") } : { source: { type: "raster", url, tileSize: 256 }, layers: PICTURES };
}

/** The bundled ground, the operator's tiles below its grid and names, over all what the style `name` adds. @param {string} name @param {Tiles} [tiles] */
async function styled(name, tiles) {
  const [ground, own] = /** @type {[MapStyle, MapStyle]} */ (await Promise.all([drawn("ground"), drawn(name)]));
  const grid = ground.layers.findIndex(({ id }) => id === "grid");
  return {
    ...ground, sources: { ...ground.sources, ...own.sources, ...(tiles && { tiles: tiles.source }) },
    layers: [...ground.layers.slice(0, grid), ...(tiles?.layers ?? []), ...ground.layers.slice(grid), ...own.layers],
  };
}

/** @param {"Point" | "LineString" | "MultiLineString" | "Polygon"} type @param {any[]} coordinates @param {GeoJSON.GeoJsonProperties} [properties] */
export function feature(type, coordinates, properties = {}) {
  return /** @type {Feature} */ ({ type: "Feature", properties, geometry: { type, coordinates } });
}

/** @param {Feature[]} features @returns {GeoJSON.FeatureCollection} */
const collection = (features) => ({ type: "FeatureCollection", features });

/** Other data for a source. @param {MapView | undefined} map @param {string} id @param {Feature[]} features */
export function put(map, id, features) {
  const source = map?.getSource(id);
  if (source instanceof maplibre.GeoJSONSource) source.setData(collection(features));
}

/** Lines a round number of metres apart over what is in view. @param {MapView} map */
function metricGrid(map) {
  if (map.getZoom() < (map.getLayer("grid")?.minzoom ?? 0)) return [];
  const [[west, south], [east, north]] = map.getBounds().toArray();
  const rough = ((north - south) * METRES_PER_DEGREE) / 5;
  const decade = 10 ** Math.floor(Math.log10(rough));
  const metres = decade * ([5, 2].find((n) => rough / decade >= n) ?? 1);
  const dLat = metres / METRES_PER_DEGREE;
  // The step in longitude is fixed on a coarse band of latitude, so that lines do not creep while panning.
  const band = Math.round((south + north) / 2);
  const dLon = dLat / Math.max(Math.cos((band * Math.PI) / 180), 0.05);
  const lines = [];
  for (let k = Math.floor(south / dLat); k * dLat <= north; k++) lines.push([[west, k * dLat], [east, k * dLat]]);
  for (let k = Math.floor(west / dLon); k * dLon <= east; k++) lines.push([[k * dLon, south], [k * dLon, north]]);
  return [feature("MultiLineString", lines)];
}

/**
 * A map in an element, by the style `name`; read again when the colour scheme changes.
 * @param {HTMLElement} host with the operator's `tiles` or `pmtiles` @param {string} name @param {Sources} sources
 */
export async function makeMap(host, name, sources) {
  const pictures = host.getAttribute("tiles"), shapes = host.getAttribute("pmtiles");
  /** @type {Tiles | undefined} */
  let tiles = pictures ? { source: { type: "raster", tiles: [pictures], tileSize: 256 }, layers: PICTURES } : undefined;
  const container = make("div", "");
  host.append(container);
  const map = new maplibre.Map({
    container, style: await styled(name, tiles), center: [12, 44], zoom: 3, maxZoom: 18,
    attributionControl: pictures || shapes ? { compact: true } : false, locale: { "Map.Title": t("Map"), "NavigationControl.ZoomIn": t("Zoom in"), "NavigationControl.ZoomOut": t("Zoom out") }, dragRotate: false, pitchWithRotate: false, fadeDuration: 0,
  });
  map.touchZoomRotate.disableRotation();
  map.addControl(new maplibre.NavigationControl({ showCompass: false }), "top-right");
  map.addControl(new maplibre.ScaleControl({ unit: UNITS }), "bottom-right");
  const drawGrid = () => put(map, "grid", metricGrid(map));
  map.on("style.load", () => {
    for (const [id, features] of Object.entries(sources())) put(map, id, features);
    drawGrid();
  });
  map.on("moveend", drawGrid);
  map.on("resize", () => frames.get(map)?.());
  map.on("movestart", (event) => { if (event.originalEvent) frames.delete(map); });
  const restyle = async () => {
    if (shapes) tiles = await archive(shapes).catch(() => tiles);  // without it the outline stays
    map.setStyle(await styled(name, tiles), { diff: false });
  };
  if (shapes) void restyle();
  onScheme(() => void restyle());
  return map;
}

/** How a map's view was framed; a reader who moved it since is left alone. @type {WeakMap<MapView, () => void>} */
const frames = new WeakMap();

/** Show the points, a single one at street zoom, also when the map changes its size. @param {MapView} map @param {LonLat[]} points @param {number} maxZoom */
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
  const line = host.querySelector(".map-note");
  if (!line) return;
  line.textContent = words;
  line.toggleAttribute("hidden", !words);
}
