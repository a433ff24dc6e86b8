// The workbench's form: the file goes up as it is, the settings beside it as JSON.

import { t } from "./words.js";

const form = /** @type {HTMLFormElement} */ (document.getElementById("ask"));
const problem = /** @type {HTMLElement} */ (document.getElementById("ask-problem"));
const bar = /** @type {HTMLProgressElement} */ (document.getElementById("ask-progress"));

/** The settings of a kind, typed as the API wants them; what is empty is left to its default. @param {string} kind */
function settings(kind) {
  /** @type {Record<string, unknown>} */
  const found = {};
  for (const field of form.querySelectorAll(`[data-for~="${kind}"] [name]`)) {
    const { name, value, dataset, type, checked } = /** @type {HTMLInputElement} */ (field);
    const text = value.trim();
    if (type === "checkbox") found[name] = checked;
    else if (text) found[name] = dataset.type === "list" ? text.split(/[\s;,]+/).map(Number) : dataset.type === "number" ? Number(text.replace(",", ".")) : text;
  }
  return found;
}

/** @param {string} words */
function say(words) {
  problem.textContent = words;
  problem.hidden = !words;
}

form.addEventListener("submit", (event) => {
  event.preventDefault();
  say("");
  const data = new FormData(form);
  const kind = String(data.get("kind"));
  const query = new URLSearchParams({ kind, parameters: JSON.stringify(settings(kind)) });
  const file = data.get("file");
  const stored = data.get("again") ? "again" : data.get("trip") ? "trip" : "";
  if (stored) query.set(stored, String(data.get(stored)));
  else if (file instanceof File && file.size) query.set("name", file.name.slice(-200));
  else return say(t("Choose a file or a trip."));
  const request = new XMLHttpRequest();  // fetch tells nothing of what has gone up
  request.open("POST", `${form.dataset.path}?${query}`);
  request.setRequestHeader("X-CSRF-Token", document.querySelector('meta[name="csrf-token"]')?.getAttribute("content") ?? "");
  request.upload.onprogress = ({ loaded, total }) => { bar.value = loaded / total; };
  request.onloadend = () => {
    bar.hidden = true;
    const told = request.getResponseHeader("content-type")?.includes("json") ? JSON.parse(request.responseText) : {};
    if (request.status === 202) location.href = `/workbench/${told.id}`;
    else say(told.detail ?? t("The service cannot be reached."));
  };
  bar.hidden = false;
  request.send(stored ? null : /** @type {File} */ (file));
});
