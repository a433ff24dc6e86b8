// <scene-3d device="id" [event="id"] [own]>: the box's 3D view, or a recorded replay of one of its events with viser's
// player, in a frame of our own origin, opened with a short-lived ticket.  `own`: a scene that nobody else sees, which
// shows what `show` asks for; the page looks after it and says when it is gone.

import { csrf, fetched, gathered, make, whenSeen } from "./page.js";
import { t } from "./words.js";

const LOOK_MS = 3000;
/** Until the view has connected. */
const FIRST_LOOK_MS = 600;
const PATIENCE = 50;
const SOON_MS = 120;

export class Scene3d extends HTMLElement {
  #base = "";
  /** @type {Choice} */ #wanted = {};
  #told = true;

  connectedCallback() {
    whenSeen(this, () => void this.#open());
    // What was at the instant under the charts' cursor.
    document.addEventListener("scatola:cursor", ({ detail: { at, values, frame } }) => this.show(at === null ? {} : { at, f: values, frame }));
  }

  /** Show something else of the box's history. @param {Choice} choice */
  show(choice) {
    if (JSON.stringify(choice) === JSON.stringify(this.#wanted)) return;
    this.#wanted = choice;
    this.#told = false;
    if (this.dataset.state === "open") this.#soon();
  }

  #soon = gathered(SOON_MS, () => void this.#ask());

  async #open() {
    this.#say(t("Opening the 3D view"));
    this.dataset.state = "opening";
    try {
      const event = this.getAttribute("event");
      const subject = event ? `events/${event}` : `devices/${this.getAttribute("device")}`;
      const ticket = await fetched(`/api/v1/${subject}/view-ticket`, { method: "POST", headers: csrf() });
      /** @type {{url: string}} */
      const { url } = await ticket.json();
      const own = this.hasAttribute("own");
      this.#base = own ? `${url}mounting/` : url;
      // Asked first, because a frame does not tell its page that it got an error.
      const view = await fetched(own ? `${this.#base}state` : url);
      void view.body?.cancel();
      const recording = event ? `${url}events/${event}.viser` : "";
      const frame = make("iframe", "");
      const dark = matchMedia("(prefers-color-scheme: dark)").matches;
      frame.title = event ? t("Replay of the event, in three dimensions") : t("Box in the vehicle, in three dimensions");
      frame.src = `${this.#base}?hideViserLogo${dark ? "&darkMode" : ""}${recording && `&playbackPath=${encodeURIComponent(recording)}`}`;
      this.replaceChildren(frame);
      if (own) void this.#lookAfter(frame);
    } catch {
      this.#lost(t("The 3D view is not running"));
    }
  }

  /** @param {HTMLIFrameElement} frame */
  async #lookAfter(frame) {
    this.#told = Object.keys(this.#wanted).length === 0;
    for (let silent = 0; frame.isConnected;) {
      await new Promise((go) => setTimeout(go, this.dataset.state === "open" ? LOOK_MS : FIRST_LOOK_MS));
      if (document.hidden) continue;
      const state = await this.#ask();
      if (!frame.isConnected) return;
      if (state?.onlookers) {
        silent = 0;
        this.dataset.state = "open";
        if (!this.#told) await this.#ask();
      } else if (++silent > (this.dataset.state === "open" ? 1 : PATIENCE)) {
        this.#lost(t("The connection to the 3D view was lost. All figures are beside it."));
        return;
      }
    }
  }

  /** What the view shows; tells it first what it should, once it is there. @returns {Promise<SceneState | null>} */
  async #ask() {
    const tell = !this.#told && this.dataset.state === "open";
    this.#told ||= tell;
    try {
      const answer = await fetched(`${this.#base}state`, tell ? { method: "PUT", headers: csrf(), body: JSON.stringify(this.#wanted) } : {});
      /** @type {SceneState} */
      const state = await answer.json();
      this.dataset.drawn = state.drawn.join(" ");
      return state;
    } catch {
      if (tell) this.#told = false;
      return null;
    }
  }

  /** @param {string} words */
  #lost(words) {
    this.dataset.state = "lost";
    const again = make("button", "", t("Try again"));
    again.type = "button";
    again.addEventListener("click", () => void this.#open());
    this.#say(words, again);
  }

  /** @param {string} words @param {HTMLElement[]} more */
  #say(words, ...more) {
    const box = make("div", "scene-words", make("p", "", words), ...more);
    box.role = "status";
    this.replaceChildren(box);
  }
}

customElements.define("scene-3d", Scene3d);
