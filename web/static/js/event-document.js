// The canonical JSON of an event, fetched once for everything on the page that draws from it.

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
