// The canonical JSON of an event, fetched once for everything on the page that draws from it.

/** @typedef {(number | null)[]} Column */
/** @typedef {{t_s: Column, delta_v_kmh_x: Column, delta_v_kmh_y: Column, sigma_kmh: Column, recorded_g_x: Column, recorded_g_y: Column, acceleration_g_x: Column, acceleration_g_y: Column, clipped: boolean[]}} Pulse */
/** @typedef {{t_s: Column, lat_deg: Column, lon_deg: Column, speed_kmh: Column, speed_sigma_kmh: Column, ellipse_long_m: Column, ellipse_short_m: Column, ellipse_deg: Column}} Way */
/** @typedef {{event: {rest: {t_s: number} | null, t0_s: number}, curves: {pulse: Pulse | null, trajectory: Way | null}}} EventDocument */

/** @type {Map<string, Promise<EventDocument>>} */
const asked = new Map();

/** @param {string} url @returns {Promise<EventDocument>} */
export function eventDocument(url) {
  let promise = asked.get(url);
  if (!promise) {
    promise = fetch(url).then((answer) => {
      if (!answer.ok) throw new Error(`no event: ${answer.status}`);
      return answer.json();
    });
    asked.set(url, promise);
  }
  return promise;
}

/** A later revision is another document. */
export function forgetDocuments() { asked.clear(); }
