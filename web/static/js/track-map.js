// <track-map last="id of the part that names the trip and position" tiles="" pmtiles="">: where the trip went, coloured
// by speed, or where the vehicle stands before the first.  The charts' cursor is a point on the way.

import { GroundMap, feature } from "./basemap.js";
import { hear, read, tell, told, whenSeen } from "./page.js";
import { t } from "./words.js";

class TrackMap extends GroundMap {
  /** @type {LonLat[]} */ #points = [];
  /** Unix seconds of each point. @type {number[]} */ #at = [];
  /** @type {(number | null)[]} */ #speed = [];
  /** Where the vehicle stands, as long as there is no trip. @type {LonLat | undefined} */ #place;
  /** What is drawn: the trip and how far it had got. */
  #drawn = "";

  connectedCallback() {
    whenSeen(this, async () => {
      const map = await this.open("track", () => this.#sources());
      map.on("mousemove", "track-edge", ({ lngLat: { lng, lat } }) => {
        // The instant at which the vehicle was here.
        const shrink = Math.cos((lat * Math.PI) / 180);
        const far = this.#points.map(([x, y]) => ((x - lng) * shrink) ** 2 + (y - lat) ** 2);
        const at = this.#at[far.indexOf(Math.min(...far))];
        if (at !== undefined) tell("place", { at });
      });
      hear("parts", () => void this.#update());
      hear("cursor", ({ at }) => {
        const k = at === null ? -1 : this.#at.findIndex((t) => t >= at), place = this.#points[k];
        this.dataset.cursor = place ? String(k) : "";
        this.put({ cursor: place ? [feature("Point", place)] : [] });
      });
      void this.#update();
    });
  }

  #sources() {
    const [first] = this.#points, last = this.#points.at(-1) ?? this.#place;
    const ends = last ? [feature("Point", last, { end: "end", say: first ? t("end") : t("last position") })] : [];
    if (first) ends.unshift(feature("Point", first, { end: "start", say: t("start") }));
    // A line has one colour: a piece from each point to the next.
    const track = this.#points.slice(1).map((place, k) => feature("LineString", [this.#points[k], place], { v: this.#speed[k + 1] ?? -1 }));
    return { track, ends };
  }

  async #update() {
    const { track = "", to, lat, lon } = told(this.getAttribute("last"));
    const key = track ? `${track} ${to}` : `${lat} ${lon}`;
    if (key === this.#drawn) return;
    this.#drawn = key;
    /** @type {Track | undefined} */
    const found = track ? await read(track).catch(() => undefined) : { geometry: null, properties: { at: [], speed_mps: [] } };
    if (key !== this.#drawn) return;  // another trip was chosen meanwhile
    if (!found) { this.note(t("The track could not be read")); this.#drawn = ""; return; }
    const { geometry, properties } = found;
    this.#points = geometry?.coordinates ?? [];
    this.#at = properties.at.map((at) => Date.parse(at) / 1000);
    this.#speed = properties.speed_mps;
    this.#place = lat && lon ? [Number(lon), Number(lat)] : undefined;
    const { length } = this.#points;
    this.note(length ? "" : track ? t("No positions of this trip") : t("Not yet: no trip to show"));
    this.put(this.#sources());
    this.querySelector(".speed-key")?.toggleAttribute("hidden", length < 2);
    this.dataset.points = String(length);
    if (length) this.fit(track, this.#points, 16);
    else if (this.#place) {
      this.dataset.place = `${lat} ${lon}`;
      this.fit("place", [this.#place], 13);
    }
  }
}

customElements.define("track-map", TrackMap);
