// Fills web/vendor from the pinned development packages (`make vendor`), so that no page ever
// asks another host for anything.  web/vendor/MANIFEST.json names every file with its origin,
// version, licence and SHA-256; tests/server/test_vendor.py holds the files to it.

import { createHash } from "node:crypto";
import { cpSync, mkdirSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";

import { feature, mesh } from "topojson-client";

const ROOT = resolve(dirname(fileURLToPath(import.meta.url)), "..");
const MODULES = join(ROOT, "node_modules");
const VENDOR = join(ROOT, "web", "vendor");

const PACKAGES = [
  {
    name: "maplibre-gl",
    licence: "BSD-3-Clause",
    copy: {
      "dist/maplibre-gl.mjs": "maplibre-gl.mjs",
      "dist/maplibre-gl-worker.mjs": "maplibre-gl-worker.mjs",
      "dist/maplibre-gl.css": "maplibre-gl.css",
      "LICENSE.txt": "LICENSE.txt",
    },
  },
  {
    // The build for a script element, with fflate (MIT) in it, made a module; the package has no file of its licence.
    name: "pmtiles",
    licence: "BSD-3-Clause",
    copy: {},
    derive: () => ({ LICENSE: BSD_3("2021 Protomaps LLC"), "pmtiles.mjs": pmtilesModule() }),
  },
  {
    // Reads QR codes where a browser cannot by itself.  MIT or Apache-2.0, as one likes.
    name: "qr",
    licence: "MIT",
    copy: { "decode.js": "decode.js", "index.js": "index.js", "LICENSE-MIT": "LICENSE-MIT" },
  },
  {
    name: "uplot",
    licence: "MIT",
    copy: {
      "dist/uPlot.esm.js": "uplot.mjs",
      "dist/uPlot.min.css": "uplot.css",
      LICENSE: "LICENSE",
    },
  },
  {
    // Natural Earth (public domain), packaged under the ISC licence.
    name: "world-atlas",
    licence: "ISC",
    copy: { LICENSE: "LICENSE" },
    derive: worldOutline,
  },
];

function pmtilesModule() {
  const script = readFileSync(join(MODULES, "pmtiles", "dist", "pmtiles.js"), "utf8").replace(/\n\/\/# sourceMappingURL.*/, "");
  return `${script.trimEnd()}\nexport const { PMTiles, Protocol } = pmtiles;\n`;
}

/** Two decimals are about a kilometre, finer than the 1:50 000 000 source is drawn. */
const round = (/** @type {number} */ degrees) => Math.round(degrees * 100) / 100;

/** Rounded points of a line without the repeats that rounding makes, longitudes running on across the date line. */
function thin(/** @type {number[][]} */ line) {
  let turns = 0;
  const points = line.map(([lon, lat], i) => {
    if (i > 0) turns -= Math.round((lon - line[i - 1][0]) / 360);
    return [round(lon + 360 * turns), round(lat)];
  });
  return points.filter((p, i) => i === 0 || p[0] !== points[i - 1][0] || p[1] !== points[i - 1][1]);
}

/** A thinned ring; one that goes around the pole is closed through it. */
function ring(/** @type {number[][]} */ line) {
  const points = thin(line);
  const [first, last] = [points[0], points[points.length - 1]];
  return first[0] === last[0] ? points : [...points, [last[0], -90], [first[0], -90], first];
}

/** Polygons of a geometry, thinned, outer rings counter-clockwise as GeoJSON has them; rings that collapse are left out. */
function polygons(geometry) {
  const parts = geometry.type === "MultiPolygon" ? geometry.coordinates : [geometry.coordinates];
  return parts
    .map((rings) => rings.map(ring).filter((points) => points.length >= 4 && Math.abs(centroid(points).area) > 1e-6))
    .filter((rings) => rings.length > 0)
    .map((rings) => rings.map((points, i) => (centroid(points).area > 0 === (i === 0) ? points : points.toReversed())));
}

/** Signed area (degrees squared) and centroid of a ring. */
function centroid(points) {
  let area = 0, lon = 0, lat = 0;
  for (let i = 0; i + 1 < points.length; i++) {
    const [[x1, y1], [x2, y2]] = [points[i], points[i + 1]];
    const cross = x1 * y2 - x2 * y1;
    area += cross / 2;
    lon += ((x1 + x2) * cross) / 6;
    lat += ((y1 + y2) * cross) / 6;
  }
  return { area, point: [round(lon / area), round(lat / area)] };
}

/** Land, borders and country names as GeoJSON. */
function worldOutline() {
  const world = JSON.parse(readFileSync(join(MODULES, "world-atlas", "countries-50m.json"), "utf8"));
  const land = feature(world, world.objects.land);
  const shapes = "features" in land ? land.features : [land];
  const borders = mesh(world, world.objects.countries, (a, b) => a !== b);
  const names = feature(world, world.objects.countries).features.map((country) => {
    const largest = polygons(country.geometry)
      .map(([outer]) => centroid(outer))
      .reduce((a, b) => (b.area > a.area ? b : a));
    return {
      type: "Feature",
      properties: { name: country.properties.name, rank: Math.round(largest.area) },
      geometry: { type: "Point", coordinates: largest.point },
    };
  });
  const collection = (features) => ({ type: "FeatureCollection", features });
  const plain = (geometry) => ({ type: "Feature", properties: {}, geometry });
  const lines = borders.coordinates.map(thin).filter((line) => line.length > 1);
  return {
    // One feature a polygon: a tile's fill is triangulated feature by feature, and the whole world in one goes wrong.
    "land.geojson": collection(
      shapes.flatMap((s) => polygons(s.geometry)).map((coordinates) => plain({ type: "Polygon", coordinates })),
    ),
    "borders.geojson": collection([plain({ type: "MultiLineString", coordinates: lines })]),
    "names.geojson": collection(names),
  };
}

/** The licence in the words of the Open Source Initiative. */
function BSD_3(holder) {
  return `Copyright ${holder}

Redistribution and use in source and binary forms, with or without modification, are permitted provided that the following conditions are met:

1. Redistributions of source code must retain the above copyright notice, this list of conditions and the following disclaimer.

2. Redistributions in binary form must reproduce the above copyright notice, this list of conditions and the following disclaimer in the documentation and/or other materials provided with the distribution.

3. Neither the name of the copyright holder nor the names of its contributors may be used to endorse or promote products derived from this software without specific prior written permission.

THIS SOFTWARE IS PROVIDED BY THE COPYRIGHT HOLDERS AND CONTRIBUTORS "AS IS" AND ANY EXPRESS OR IMPLIED WARRANTIES, INCLUDING, BUT NOT LIMITED TO, THE IMPLIED WARRANTIES OF MERCHANTABILITY AND FITNESS FOR A PARTICULAR PURPOSE ARE DISCLAIMED. IN NO EVENT SHALL THE COPYRIGHT HOLDER OR CONTRIBUTORS BE LIABLE FOR ANY DIRECT, INDIRECT, INCIDENTAL, SPECIAL, EXEMPLARY, OR CONSEQUENTIAL DAMAGES (INCLUDING, BUT NOT LIMITED TO, PROCUREMENT OF SUBSTITUTE GOODS OR SERVICES; LOSS OF USE, DATA, OR PROFITS; OR BUSINESS INTERRUPTION) HOWEVER CAUSED AND ON ANY THEORY OF LIABILITY, WHETHER IN CONTRACT, STRICT LIABILITY, OR TORT (INCLUDING NEGLIGENCE OR OTHERWISE) ARISING IN ANY WAY OUT OF THE USE OF THIS SOFTWARE, EVEN IF ADVISED OF THE POSSIBILITY OF SUCH DAMAGE.
`;
}

const sha256 = (path) => createHash("sha256").update(readFileSync(path)).digest("hex");

function main() {
  rmSync(VENDOR, { recursive: true, force: true });
  const manifest = PACKAGES.map(({ name, licence, copy, derive }) => {
    const target = join(VENDOR, name);
    mkdirSync(target, { recursive: true });
    for (const [from, to] of Object.entries(copy)) cpSync(join(MODULES, name, from), join(target, to));
    for (const [file, content] of Object.entries(derive?.() ?? {})) {
      writeFileSync(join(target, file), typeof content === "string" ? content : `${JSON.stringify(content)}\n`);
    }
    const files = readdirSync(target).sort();
    const { version } = JSON.parse(readFileSync(join(MODULES, name, "package.json"), "utf8"));
    return { name, version, licence, files: files.map((file) => ({ path: `${name}/${file}`, sha256: sha256(join(target, file)) })) };
  });
  writeFileSync(join(VENDOR, "MANIFEST.json"), `${JSON.stringify(manifest, null, 2)}\n`);
}

main();
