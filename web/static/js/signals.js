// Reads the answer of GET /api/v1/devices/{id}/signals: header length, JSON header, times and columns.

/** @typedef {{columns: string[], count: number}} Group */
/** @typedef {{t0: string, frame: "a" | "v", from: string, to: string, units: Record<string, string>, groups: Group[], gaps: [number, number][]}} Header */
/** @typedef {{header: Header, series: Record<string, {t: Float64Array, values: Float32Array}>}} Signals */

/** @param {ArrayBuffer} body @returns {Signals} */
export function decode(body) {
  const headerLength = new DataView(body).getUint32(0, true);
  /** @type {Header} */
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(body, 4, headerLength)));
  /** @type {Signals["series"]} */
  const series = {};
  let offset = 4 + headerLength;
  for (const { columns, count } of header.groups) {
    // Sliced, because a typed array must begin at a multiple of its element's size.
    const t = new Float64Array(body.slice(offset, offset + 8 * count));
    offset += 8 * count;
    for (const name of columns) {
      series[name] = { t, values: new Float32Array(body.slice(offset, offset + 4 * count)) };
      offset += 4 * count;
    }
  }
  return { header, series };
}
