// Shapes that the site's scripts share; nothing of this is sent to a browser.

type MapView = import("maplibre-gl").Map;
type MapStyle = import("maplibre-gl").StyleSpecification;

/** Of a list row on the map, as GET /fleet/places tells it. */
type Spot = [id: string, url: string, name: string, mark: string, words: string, lat: number, lon: number];

type LonLat = [number, number];

/** What the live stream tells. */
type Change = { at: string; device_id: string | null; vehicle_id: string | null };

/** GET /api/v1/trips/{id}/track. */
type Track = { geometry: { coordinates: [number, number][] } | null; properties: { at: string[]; speed_mps: (number | null)[] } };

/** GET /api/v1/devices/{id}/signals. */
type SignalHeader = {
  t0: string; frame: "a" | "v"; from: string; to: string; units: Record<string, string>;
  groups: { columns: string[]; count: number }[]; gaps: [number, number][];
};
type Signals = { header: SignalHeader; series: Record<string, { t: Float64Array; values: Float32Array }> };
type TimeWindow = { seconds: number } | { from: string; to: string };

/** GET /api/v1/events/{id}/event.json, as far as it is drawn. */
type Column = (number | null)[];
type Pulse = {
  t_s: Column; delta_v_kmh_x: Column; delta_v_kmh_y: Column; sigma_kmh: Column; recorded_g_x: Column; recorded_g_y: Column;
  acceleration_g_x: Column; acceleration_g_y: Column; clipped: boolean[];
};
type Way = {
  t_s: Column; lat_deg: Column; lon_deg: Column; speed_kmh: Column; speed_sigma_kmh: Column;
  ellipse_long_m: Column; ellipse_short_m: Column; ellipse_deg: Column;
};
type EventDocument = { event: { rest: { t_s: number } | null; t0_s: number }; curves: { pulse: Pulse | null; trajectory: Way | null } };
type Curve = { label: string; values: Column; stroke: string; dash?: number[]; sigma?: Column };
