// The installation assistant: scanning a code where the browser can, and a sign when the box is ready.

import { Scene3d } from "./scene-3d.js";
import { t } from "./words.js";

/** @typedef {{detect(source: HTMLVideoElement): Promise<{rawValue: string}[]>}} Detector */
const Detectors = /** @type {{BarcodeDetector?: new (options: {formats: string[]}) => Detector}} */ (window).BarcodeDetector;
const scan = /** @type {HTMLButtonElement | null} */ (document.getElementById("scan"));
const video = document.querySelector("video");

if (scan && video && Detectors && "mediaDevices" in navigator) {
  scan.hidden = false;
  scan.addEventListener("click", () => void look(new Detectors({ formats: ["qr_code", "code_128", "data_matrix"] })));
}

/** @param {Detector} detector */
async function look(detector) {
  if (!scan || !video) return;
  const words = document.getElementById("scan-words");
  try {
    video.srcObject = await navigator.mediaDevices.getUserMedia({ video: { facingMode: "environment" } });
  } catch {
    if (words) words.textContent = t("The camera is not allowed or not there: type the code.");
    return;
  }
  scan.hidden = true;
  video.hidden = false;
  await video.play();
  for (;;) {
    const [found] = await detector.detect(video);
    if (found) { done(found.rawValue); return; }
    await new Promise((go) => setTimeout(go, 200));
  }
}

/** @param {string} code */
function done(code) {
  const stream = video?.srcObject;
  if (stream instanceof MediaStream) for (const track of stream.getTracks()) track.stop();
  const field = document.getElementById("code");
  if (!(field instanceof HTMLInputElement)) return;
  field.value = code;
  field.form?.requestSubmit();
}

// One of the four orientations, to be looked at from all sides.
const proposals = [...document.querySelectorAll("[data-proposal]")];
for (const one of proposals) {
  one.addEventListener("click", () => {
    for (const other of proposals) other.setAttribute("aria-pressed", String(other === one));
    const scene = document.querySelector("scene-3d");
    if (scene instanceof Scene3d) scene.show({ proposal: Number(one.getAttribute("data-proposal")) });
  });
}

// Off unless switched on: a car park at night, a meeting.  A sound needs the press that switches it on.
const signal = /** @type {HTMLInputElement | null} */ (document.getElementById("signal"));
/** @type {AudioContext | undefined} */
let audio;
let was = ready();

function ready() {
  return document.getElementById("progress")?.dataset.ready === "yes";
}

signal?.addEventListener("change", () => { if (signal.checked) audio ??= new AudioContext(); });
document.addEventListener("scatola:parts", () => {
  const now = ready();
  if (now && !was && signal?.checked) {
    navigator.vibrate?.([200, 100, 200]);
    if (audio) {
      const tone = new OscillatorNode(audio, { frequency: 880 });
      tone.connect(new GainNode(audio, { gain: 0.2 })).connect(audio.destination);
      tone.start();
      tone.stop(audio.currentTime + 0.5);
    }
  }
  was = now;
});
