// The installation assistant: scanning a code, orientations in 3D, a sign when the box is ready.

import { hear, told } from "./page.js";
import "./scene-3d.js";
import { t } from "./words.js";

const scan = document.getElementById("scan");
const video = document.querySelector("video");
const field = document.getElementById("code");

if (scan && video && field instanceof HTMLInputElement && navigator.mediaDevices) {
  scan.hidden = false;
  scan.addEventListener("click", async () => {
    try {
      const stream = await navigator.mediaDevices.getUserMedia({ video: { facingMode: "environment" } });
      video.srcObject = stream;
      scan.hidden = true;
      video.hidden = false;
      await video.play();
      const Detector = window.BarcodeDetector ?? (await import("../vendor/qr/decode.js")).BarcodeDetector;
      const detector = new Detector({ formats: ["qr_code", "code_128", "data_matrix"] });
      for (;;) {
        const [found] = await detector.detect(video);
        if (found) {
          for (const track of stream.getTracks()) track.stop();
          field.value = found.rawValue;
          field.form?.requestSubmit();
          return;
        }
        await new Promise((go) => setTimeout(go, 200));
      }
    } catch {
      const words = document.getElementById("scan-words");
      if (words) words.textContent = t("The camera is not allowed or not there: type the code.");
    }
  });
}

// One of the four orientations, to be looked at from all sides.
const proposals = [...document.querySelectorAll("[data-proposal]")];
for (const one of proposals) {
  one.addEventListener("click", () => {
    for (const other of proposals) other.ariaPressed = String(other === one);
    document.querySelector("scene-3d")?.show({ proposal: Number(one.getAttribute("data-proposal")) });
  });
}

// Off unless switched on: a car park at night, a meeting.  A sound needs the press that switches it on.
const signal = document.getElementById("signal");
/** @type {AudioContext | undefined} */ let audio;
const ready = () => told("progress").ready === "yes";
let was = ready();

signal?.addEventListener("change", () => { audio ??= new AudioContext(); });
hear("parts", () => {
  if (ready() && !was && audio && signal instanceof HTMLInputElement && signal.checked) {
    navigator.vibrate?.([200, 100, 200]);
    const tone = new OscillatorNode(audio, { frequency: 880 });
    tone.connect(new GainNode(audio, { gain: 0.2 })).connect(audio.destination);
    tone.start();
    tone.stop(audio.currentTime + 0.5);
  }
  was = ready();
});
