import { PER_MPS, t } from "./words.js";

/** Samples of a box, speeds in the reader's unit; fails with words for the reader. @type {FetchSignals} */
export const fetchSignals = async (device, query, signal) => {
  const answer = await fetch(`/api/v1/devices/${device}/signals?${new URLSearchParams(query)}`, { signal }).catch((error) => {
    throw new Error(t("The service cannot be reached."), { cause: error });
  });
  if (answer.ok) return decode(await answer.arrayBuffer());
  const { detail } = await answer.json().catch(() => ({}));
  throw new Error(detail ?? t("The signals could not be read"));
};

/** @param {number} s Unix seconds */
export const iso = (s) => new Date(s * 1000).toISOString();

/** The answer: length of the header, header in JSON, times and columns. @param {ArrayBuffer} body @returns {Signals} */
function decode(body) {
  const headerLength = new DataView(body).getUint32(0, true);
  /** @type {SignalHeader} */
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(body, 4, headerLength)));
  /** @type {Signals["series"]} */
  const series = {};
  const t0 = Date.parse(header.t0) / 1000;
  let offset = 4 + headerLength;
  for (const { columns, count } of header.groups) {
    // Sliced, because a typed array must begin at a multiple of its element's size.
    const t = new Float64Array(body.slice(offset, offset + 8 * count)).map((s) => t0 + s);
    offset += 8 * count;
    for (const name of columns) {
      const factor = name === "speed" ? PER_MPS : 1;
      series[name] = { t, values: Array.from(new Float32Array(body.slice(offset, offset + 4 * count)), (v) => (Number.isNaN(v) ? null : v * factor)) };
      offset += 4 * count;
    }
  }
  return { header, series };
}
