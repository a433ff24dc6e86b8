// Shapes that the site's scripts share; nothing of this is sent to a browser.

type MapView = import("maplibre-gl").Map;
type MapStyle = import("maplibre-gl").StyleSpecification;
type Layer = import("maplibre-gl").LayerSpecification;
/** The features of a map's own sources, as they are now. */
type Sources = () => Record<string, Feature[]>;
type Tiles = { source: import("maplibre-gl").SourceSpecification; layers: Layer[] };
type Feature = GeoJSON.Feature<Exclude<GeoJSON.Geometry, GeoJSON.GeometryCollection> & { coordinates: any }>;

/** Of a list row on the map, as GET /fleet/places tells it. */
type Spot = [id: string, url: string, name: string, mark: string, words: string, lat: number, lon: number];

type LonLat = [number, number];

/** What the live stream tells, as far as scripts read it. */
type Change = {
  kind: string; at: string; device_id: string | null; vehicle_id: string | null;
  lat_deg?: number | null; lon_deg?: number | null; event_id?: string; revision?: number;
};

/** What scripts tell each other, as events `scatola:...` of the document. */
type News = {
  change: Change;
  /** Parts of the page were swapped. */
  parts: null;
  zone: null;
  /** Under the charts' cursor: the instant (Unix s; of an event's charts s from time zero), the values, their axes. */
  cursor: { at: number | null; values: Value[]; frame?: string };
  /** The instant that the charts are to show: under the pointer on the map, in the replay, or led to by keys. */
  place: { at: number };
};

interface HTMLElementTagNameMap {
  "scene-3d": import("../static/js/scene-3d.js").Scene3d;
}

/** What a 3D view of one's own shows, and what it tells of itself. */
type Choice = { step?: string | null; before?: boolean; proposal?: number | null; at?: number | null; f?: Value[]; frame?: string };
type SceneState = { onlookers: number; drawn: string[] };

/** What leads an event's replay. */
interface ReplayBar extends HTMLFieldSetElement {
  elements: HTMLCollection & { play: HTMLInputElement; at: HTMLInputElement; speed: HTMLSelectElement; words: HTMLOutputElement };
}

/** Reading codes (not in TypeScript's library). */
declare class BarcodeDetector {
  constructor(options: { formats: string[] });
  detect(source: HTMLVideoElement): Promise<{ rawValue: string }[]>;
}
interface Window { BarcodeDetector?: typeof BarcodeDetector }

type Timer = ReturnType<typeof setTimeout> | undefined;

/** GET /api/v1/trips/{id}/track. */
type Track = { geometry: { coordinates: [number, number][] } | null; properties: { at: string[]; speed_mps: (number | null)[] } };

/** GET /api/v1/devices/{id}/signals. */
type SignalHeader = {
  t0: string; frame: "a" | "v"; from: string; to: string; units: Record<string, string>;
  groups: { columns: string[]; count: number }[]; gaps: [number, number][];
};
/** `t` in Unix seconds. */
type Samples = { t: Float64Array; values: Column };
type Signals = { header: SignalHeader; series: Record<string, Samples> };
type TimeWindow = { seconds: number } | { from: string; to: string };

/** GET /api/v1/events/{id}/event.json, as far as it is drawn. */
type Value = number | null | undefined;
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
type Plot = import("uplot");
/** The values that an axis shows, by those that there are. */
type ValueRange = (plot: Plot, low: number, high: number) => [number, number];
type Ticks = (plot: Plot, ticks: number[]) => string[];
/** A chart's options besides those that all charts have; `lines` are the series without the time. */
type PlotParameters = ConstructorParameters<typeof import("uplot")>;
type PlotOptions = PlotParameters[0];
type PlotData = NonNullable<PlotParameters[1]>;
type ChartOptions = Omit<Partial<PlotOptions>, "series" | "axes"> & { lines: PlotOptions["series"]; ticks?: Ticks };
type Point = { t: number; place: LonLat; k: number };
type Curve = { values: Column; stroke: string; dash?: number[]; sigma?: Column };

// Functions of the scripts, by their use.
type WhenSeen = (element: Element, run: () => void) => void;
type Make = <K extends keyof HTMLElementTagNameMap>(tag: K, ...children: (Node | string)[]) => HTMLElementTagNameMap[K];
type Gathered = (ms: number, run: () => void) => () => void;
type Fetched<Found = Response> = (url: string, options?: RequestInit) => Promise<Found>;
type Hear = <K extends keyof News>(what: K, run: (news: News[K]) => void) => void;
type Tell = <K extends keyof News>(what: K, news: News[K]) => void;
type Worded = (name: string) => string;
type Said = (words: string, values?: Record<string, string | number>) => string;
type Signed = (value: number, digits?: number) => string;
type Formatter = (style: Intl.DateTimeFormatOptions) => Intl.DateTimeFormat;
type FetchSignals = (device: string | null, query: Record<string, any>, signal?: AbortSignal) => Promise<Signals>;
type Pictures = (where: { tiles: string[] } | { url: string }) => Tiles;
type MakeFeature = (
  type: "Point" | "LineString" | "MultiLineString" | "Polygon", coordinates: any[], properties?: GeoJSON.GeoJsonProperties,
) => Feature;
/** `wanted` in s; the mark's kind in English, and what the map says of it. */
type Mark = (points: Point[], wanted: number | null, words?: string, say?: string) => Feature[];
type Converted = (values: Column) => Column;
/** Half axes in m, `turn` in degrees from north. */
type Ellipse = (place: LonLat, long: Value, short: Value, turn: Value) => Feature[];
