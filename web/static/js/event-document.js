import { fetched } from "./page.js";

/** @type {Map<string, Promise<EventDocument>>} */
const asked = new Map();

/** The canonical JSON of the event that an element draws from, fetched once for the whole page. @param {Element} element @returns {Promise<EventDocument>} */
export function eventDocument(element) {
  const url = element.getAttribute("document") ?? "";
  const promise = asked.get(url) ?? fetched(url).then((answer) => answer.json());
  asked.set(url, promise);
  return promise;
}

/** A later revision is another document. */
export function forgetDocuments() { asked.clear(); }
