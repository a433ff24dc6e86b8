// <scene-3d device="id" [event="id"]>: the box's 3D view, or a recorded replay of one of its events with viser's
// player, in a frame of our own origin, opened with a short-lived ticket.

import { whenSeen } from "./seen.js";
import { t } from "./words.js";

class Scene3d extends HTMLElement {
  connectedCallback() {
    whenSeen(this, () => void this.#open());
  }

  async #open() {
    this.#say(t("Opening the 3D view"));
    const token = document.querySelector('meta[name="csrf-token"]')?.getAttribute("content") ?? "";
    try {
      const event = this.getAttribute("event");
      const subject = event ? `events/${event}` : `devices/${this.getAttribute("device")}`;
      const answer = await fetch(`/api/v1/${subject}/view-ticket`, { method: "POST", headers: { "X-CSRF-Token": token } });
      if (!answer.ok) throw new Error(`no ticket: ${answer.status}`);
      /** @type {{url: string}} */
      const { url } = await answer.json();
      // Asked first, because a frame does not tell its page that it got an error.
      const view = await fetch(url);
      void view.body?.cancel();
      if (!view.ok) throw new Error(`no view: ${view.status}`);
      const recording = event ? `${url}events/${event}.viser` : "";
      const frame = document.createElement("iframe");
      const dark = matchMedia("(prefers-color-scheme: dark)").matches;
      frame.title = event ? t("Replay of the event, in three dimensions") : t("Box in the vehicle, in three dimensions");
      frame.src = `${url}?hideViserLogo${dark ? "&darkMode" : ""}${recording && `&playbackPath=${encodeURIComponent(recording)}`}`;
      this.replaceChildren(frame);
    } catch {
      const again = document.createElement("button");
      again.type = "button";
      again.textContent = t("Try again");
      again.addEventListener("click", () => void this.#open());
      this.#say(t("The 3D view is not running"), again);
    }
  }

  /** @param {string} words @param {HTMLElement[]} more */
  #say(words, ...more) {
    const box = document.createElement("div");
    box.className = "scene-words";
    const line = document.createElement("p");
    line.textContent = words;
    box.append(line, ...more);
    this.replaceChildren(box);
  }
}

customElements.define("scene-3d", Scene3d);
