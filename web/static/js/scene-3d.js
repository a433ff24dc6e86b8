// <scene-3d device="id">: the box's 3D view, a scene that nobody else sees, which shows what `show` asks for; the page
// looks after it and says when it is gone.  <scene-3d event="id">: a recorded replay in viser's player, led by the
// <fieldset> after it and by the charts' cursor, which it leads in turn.  In a frame of our own origin, opened with a short-lived ticket.

import { dark, fetched, gathered, hear, make, read, tell, whenSeen } from "./page.js";
import { signed, t } from "./words.js";

const LOOK_MS = 3000, SOON_MS = 120;
/** Until the view has connected, and how often. */
const FIRST_LOOK_MS = 600, PATIENCE = 50;
/** As fine as the replay's frames. */
const FOLLOW_MS = 50;

export class Scene3d extends HTMLElement {
  #base = "";
  /** What the view is to show, and what it was told last: a Choice in JSON. */ #wanted = "{}"; #told = "{}";
  /** The instant that the reader points at, until the replay shows it. @type {number | null} */ #sought = null;
  get #event() { return this.getAttribute("event"); }

  connectedCallback() {
    whenSeen(this, () => void this.#open());
    // What was at the instant under the charts' cursor.
    hear("cursor", ({ at, values, frame }) => {
      if (this.#event) this.#sought = at;
      else this.show(at === null ? {} : { at, f: values, frame });
    });
  }

  /** Show something else of the box's history. @param {Choice} choice */
  show(choice) {
    this.#wanted = JSON.stringify(choice);
    if (this.#wanted !== this.#told) this.#soon();
  }

  #soon = gathered(SOON_MS, () => { if (this.dataset.state === "open") void this.#ask(); });

  async #open() {
    this.#say("opening", t("Opening the 3D view"));
    try {
      const event = this.#event, subject = event ? `events/${event}` : `devices/${this.getAttribute("device")}`;
      /** @type {{url: string}} */
      const { url } = await read(`/api/v1/${subject}/view-ticket`, { method: "POST" });
      this.#base = event ? url : `${url}mounting/`;
      // Asked first, because a frame does not tell its page that it got an error.
      const view = await fetched(event ? url : `${this.#base}state`);
      void view.body?.cancel();
      const frame = make("iframe");
      frame.title = event ? t("Replay of the event, in three dimensions") : t("Box in the vehicle, in three dimensions");
      frame.src = `${this.#base}?hideViserLogo${dark.matches ? "&darkMode" : ""}${event ? `&playbackPath=${encodeURIComponent(`${url}events/${event}.viser`)}` : ""}`;
      this.replaceChildren(frame);
      if (event) this.#link(frame);
      else void this.#lookAfter(frame);
    } catch {
      this.#lost(t("The 3D view is not running"));
    }
  }

  /** One instant in the replay, its slider and the charts.  It is played here: the player's own clock shows tenths of a second. @param {HTMLIFrameElement} frame */
  #link(frame) {
    const { play, at: slider, speed, words } = /** @type {ReplayBar} */ (this.nextElementSibling).elements;
    const from = Number(slider.min), to = Number(slider.max);
    play.checked = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    let at = play.checked ? from : 0, shown = NaN, then = performance.now();
    slider.oninput = () => { play.checked = false; at = slider.valueAsNumber; };
    setInterval(() => {
      const passed = performance.now() - then, sought = this.#sought;
      then += passed;
      /** Time of the player, s from `from`. @type {HTMLInputElement | null | undefined} */
      const time = frame.contentDocument?.querySelector('input[inputmode="decimal"]');
      if (!time) return;
      this.dataset.state = "open";
      if (sought !== null) at = Math.min(Math.max(sought, from), to);
      else if (play.checked) at = Math.min((at < to ? at : from) + passed / 1000 * Number(speed.value), to);
      if (sought !== null || at === to) play.checked = false;
      if (at !== shown) {
        shown = slider.valueAsNumber = at;
        slider.ariaValueText = words.value = `${signed(at, 3)} s`;
        // React keeps a setter of its own on the element; the player pauses.
        Reflect.set(HTMLInputElement.prototype, "value", (at - from).toFixed(4), time);
        time.dispatchEvent(new Event("input", { bubbles: true }));
        if (sought === null) tell("place", { at });
      }
      // Also what the charts' cursor said when it was led: an echo.
      this.#sought = null;
    }, FOLLOW_MS);
  }

  /** @param {HTMLIFrameElement} frame */
  async #lookAfter(frame) {
    this.#told = "{}";
    for (let silent = 0; frame.isConnected;) {
      await new Promise((go) => setTimeout(go, this.dataset.state === "open" ? LOOK_MS : FIRST_LOOK_MS));
      if (document.hidden) continue;
      const state = await this.#ask();
      if (!frame.isConnected) return;
      if (state?.onlookers) {
        silent = 0;
        this.dataset.state = "open";
        if (this.#wanted !== this.#told) await this.#ask();
      } else if (++silent > (this.dataset.state === "open" ? 1 : PATIENCE)) {
        this.#lost(t("The connection to the 3D view was lost. All figures are beside it."));
        return;
      }
    }
  }

  /** What the view shows; tells it first what it should, once it is there. @returns {Promise<SceneState | null>} */
  async #ask() {
    const body = this.#wanted, telling = this.dataset.state === "open" && body !== this.#told;
    try {
      /** @type {SceneState} */
      const state = await read(`${this.#base}state`, telling ? { method: "PUT", body } : {});
      if (telling) this.#told = body;
      this.dataset.drawn = state.drawn.join(" ");
      return state;
    } catch {
      return null;
    }
  }

  /** @param {string} words */
  #lost(words) {
    const again = make("button", t("Try again"));
    again.addEventListener("click", () => void this.#open());
    this.#say("lost", words, again);
  }

  /** @param {string} state @param {string} words @param {HTMLElement[]} more */
  #say(state, words, ...more) {
    this.dataset.state = state;
    const box = make("div", make("p", words), ...more);
    box.role = "status";
    this.replaceChildren(box);
  }
}

customElements.define("scene-3d", Scene3d);
