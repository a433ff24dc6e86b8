// What scripts say, in the reader's language: English as it stands in the code, else what the page brought along.

/** @type {Record<string, string>} */
const found = JSON.parse(document.querySelector('meta[name="words"]')?.getAttribute("content") ?? "{}");

export const LANGUAGE = document.documentElement.lang === "it" ? "it-IT" : "en-GB";

/** With values for each {name}. @type {Said} */
export const t = (words, values = {}) => (found[words] ?? words).replace(/\{(\w+)\}/g, (_, name) => String(values[name] ?? ""));

export const UNITS = document.documentElement.dataset.units === "imperial" ? "imperial" : "metric";
/** The reader's speed for 1 m/s. */
export const PER_MPS = UNITS === "imperial" ? 3600 / 1609.344 : 3.6;

/** As the language writes it, with the sign that typography has for minus. @type {Signed} */
export const signed = (value, digits) => value.toLocaleString(LANGUAGE, { minimumFractionDigits: digits, maximumFractionDigits: digits ?? 3, useGrouping: false, signDisplay: "negative" }).replace("-", "−");
