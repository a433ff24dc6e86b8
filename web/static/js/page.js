// What most scripts do with their page.

/** Run once an element comes near the view: what nobody looks at need not be drawn. @param {Element} element @param {() => void} run */
export function whenSeen(element, run) {
  const observer = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    observer.disconnect();
    run();
  }, { rootMargin: "200px" });
  observer.observe(element);
}

/** @template {keyof HTMLElementTagNameMap} K @param {K} tag @param {(Node | string)[]} children */
export function make(tag, ...children) {
  const made = document.createElement(tag);
  made.append(...children);
  return made;
}

/** What the server tells scripts in a part of the page, as it is now. @param {string | null} id @returns {DOMStringMap} */
export const told = (id) => document.getElementById(id ?? "")?.dataset ?? {};

/** A function that runs once for all calls within a while, if somebody looks. @param {number} ms @param {() => void} run */
export function gathered(ms, run) {
  /** @type {Timer} */ let waiting;
  return () => {
    waiting ??= setTimeout(() => {
      waiting = undefined;
      if (!document.hidden) run();
    }, ms);
  };
}

const headers = { "X-CSRF-Token": document.querySelector('meta[name="csrf-token"]')?.getAttribute("content") ?? "" };

/** An answer of our own server that is no refusal. @param {string} url @param {RequestInit} [options] */
export async function fetched(url, options) {
  const answer = await fetch(url, { headers, ...options });
  if (!answer.ok) throw new Error(`${answer.status} from ${url}`);
  return answer;
}

/** The JSON of such an answer; the caller knows its type. @param {string} url @param {RequestInit} [options] @returns {Promise<any>} */
export const read = async (url, options) => (await fetched(url, options)).json();

/** Follow what scripts tell each other on the document. @template {keyof News} K @param {K} what @param {(news: News[K]) => void} run */
export function hear(what, run) {
  document.addEventListener(`scatola:${what}`, (event) => run(/** @type {CustomEvent} */ (event).detail));
}

/** @template {keyof News} K @param {K} what @param {News[K]} news */
export function tell(what, news) {
  document.dispatchEvent(new CustomEvent(`scatola:${what}`, { detail: news }));
}

/** Colour of a CSS variable in the reader's scheme. @param {string} name */
export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

/** Run when the reader changes between light and dark. @param {() => void} run */
export function onScheme(run) {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", run);
}
