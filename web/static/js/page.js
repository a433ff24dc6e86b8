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

/** @template {keyof HTMLElementTagNameMap} K @param {K} tag @param {string} className @param {(Node | string)[]} children */
export function make(tag, className, ...children) {
  const made = document.createElement(tag);
  made.className = className;
  made.append(...children);
  return made;
}

/** What the server tells scripts in a part of the page, as it is now. @param {string | null} id @returns {DOMStringMap} */
export function told(id) {
  return document.getElementById(id ?? "")?.dataset ?? {};
}

/** @param {Event} event */
export function pressedButton(event) {
  return event.target instanceof Element ? event.target.closest("button") : null;
}

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

/** An answer that is no refusal. @param {string} url @param {RequestInit} [options] */
export async function fetched(url, options) {
  const answer = await fetch(url, options);
  if (!answer.ok) throw new Error(`${answer.status} from ${url}`);
  return answer;
}

export function csrf() {
  return { "X-CSRF-Token": document.querySelector('meta[name="csrf-token"]')?.getAttribute("content") ?? "" };
}
