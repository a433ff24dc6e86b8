// Reads the answer of GET /api/v1/devices/{id}/signals: header length, JSON header, times and columns.

/** @param {ArrayBuffer} body @returns {Signals} */
export function decode(body) {
  const headerLength = new DataView(body).getUint32(0, true);
  /** @type {SignalHeader} */
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
