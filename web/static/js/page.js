// What most scripts do with their page.

/** Run once an element comes near the view: what nobody looks at need not be drawn. @type {WhenSeen} */
export const whenSeen = (element, run) => {
  const observer = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    observer.disconnect();
    run();
  }, { rootMargin: "200px" });
  observer.observe(element);
};

/** @type {Make} */
export const make = (tag, ...children) => {
  const made = document.createElement(tag);
  made.append(...children);
  return made;
};

/** What the server tells scripts in a part of the page, as it is now. @param {string | null} id @returns {DOMStringMap} */
export const told = (id) => document.getElementById(id ?? "")?.dataset ?? {};

/** A function that runs once for all calls within a while, if somebody looks. @type {Gathered} */
export const gathered = (ms, run) => {
  /** @type {Timer} */ let waiting;
  return () => {
    waiting ??= setTimeout(() => {
      waiting = undefined;
      if (!document.hidden) run();
    }, ms);
  };
};

export const dark = matchMedia("(prefers-color-scheme: dark)");

const headers = { "X-CSRF-Token": document.querySelector('meta[name="csrf-token"]')?.getAttribute("content") ?? "" };

/** An answer of our own server that is no refusal. @type {Fetched} */
export const fetched = async (url, options) => {
  const answer = await fetch(url, { headers, ...options });
  if (!answer.ok) throw new Error(`${answer.status} from ${url}`);
  return answer;
};

/** The JSON of such an answer; the caller knows its type. @type {Fetched<any>} */
export const read = async (url, options) => (await fetched(url, options)).json();

/** Follow what scripts tell each other on the document. @type {Hear} */
export const hear = (what, run) => document.addEventListener(`scatola:${what}`, (event) => run(/** @type {CustomEvent} */ (event).detail));

/** @type {Tell} */
export const tell = (what, detail) => { document.dispatchEvent(new CustomEvent(`scatola:${what}`, { detail })); };

/** Colour of a CSS variable in the reader's scheme. @type {Worded} */
export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
