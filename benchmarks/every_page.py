"""Time until each page of the demo fleet can be used, and until a 3D view shows its scene.

The clock is the page's own, from the beginning of its navigation.  A page can be used when the live stream stands and
every map and chart that is in view has drawn its data; a scene is there when colours are in its canvas: axes, the box,
an event's path.

.venv/bin/python benchmarks/every_page.py
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import sys
from pathlib import Path

from playwright.sync_api import BrowserContext, Page, sync_playwright

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from scripts.screenshots import FLAGS, demo_fleet

REPEAT = 5
PAGES = (
    "/", "/vehicles", "{vehicle}", "/events", "{event}", "/trips", "/alerts", "/install", "/install/{box}",
    "/install/{box}/drive", "/install/{box}/level", "/devices/{box}/live", "/devices/{box}/certificate", "/workbench",
    "/admin", "/admin/boxes", "/admin/boxes/{box}", "/admin/alerts", "/admin/work", "/admin/versions", "/users",
    "/privacy", "/audit", "/account",
)  # fmt: skip
SCENES = ("/devices/{box}/mounting", "{vehicle}", "{event}")
USABLE = """(() => {
  const wanted = { "fleet-map": "data-marks", "track-map": "data-points", "signal-chart": "data-points",
                   "event-charts": "data-drawn", "event-map": "data-points" };
  const inView = (e) => { const r = e.getBoundingClientRect(); return r.top < innerHeight && r.bottom > 0; };
  const look = () => {
    const on = document.getElementById("live")?.dataset.state === "on";
    if (on && Object.entries(wanted).every(([tag, mark]) =>
        [...document.querySelectorAll(tag)].every((e) => !inView(e) || e.hasAttribute(mark)))) {
      window.usableAt = performance.now();
      return;
    }
    requestAnimationFrame(look);
  };
  if (window.top === window) requestAnimationFrame(look);
})()"""
# Runs in the viewer's frame, whose canvas is told to keep what was drawn until somebody has looked.
DRAWN = """(() => {
  if (window.top === window) return;
  const context = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, options) {
    return context.call(this, kind, { ...options, preserveDrawingBuffer: true });
  };
  const small = new OffscreenCanvas(160, 110).getContext("2d", { willReadFrequently: true });
  const look = () => {
    // The client has small canvases beside its picture.
    const [canvas] = [...document.querySelectorAll("canvas")].sort((a, b) => b.width - a.width);
    if (canvas && canvas.width > 300) {
      small.drawImage(canvas, 0, 0, 160, 110);
      const { data } = small.getImageData(0, 0, 160, 110);
      let coloured = 0;
      for (let k = 0; k < data.length; k += 4) {
        const [r, g, b, a] = data.subarray(k, k + 4);
        if (a && Math.max(r, g, b) - Math.min(r, g, b) > 60) coloured++;
      }
      if (coloured > 18) {
        window.top.drawnAt = performance.timeOrigin + performance.now() - window.top.performance.timeOrigin;
        return;
      }
    }
    setTimeout(look, 100);
  };
  look();
})()"""


def seconds(context: BrowserContext, address: str, mark: str) -> list[float]:
    """What the page's own clock says, some times, each in a page of its own."""
    found = []
    for _ in range(REPEAT):
        page = context.new_page()
        page.goto(address, wait_until="commit")
        page.wait_for_function(f"window.{mark}", timeout=60_000)
        found.append(page.evaluate(f"window.{mark}") / 1000.0)
        page.close()
    return found


def places(page: Page, origin: str) -> dict[str, str]:
    """Addresses of the demo's crash, its vehicle and box."""
    page.goto(origin + "/events")
    event = page.locator("main a[href^='/events/']").first
    event.wait_for(timeout=180_000)
    found = {"event": event.get_attribute("href") or ""}
    event.click()
    found["vehicle"] = page.locator(".heading a[href^='/vehicles/']").get_attribute("href") or ""
    page.goto(origin + found["vehicle"])
    found["box"] = page.locator("scene-3d").get_attribute("device") or ""
    return found


def main() -> None:
    """Start the demo, wait for its crash, look at everything, print."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--scenes", action="store_true", help="the 3D views alone")
    only_scenes = asked.parse_args().scenes
    with demo_fleet() as link, sync_playwright() as playwright:
        origin = link.split("/login", maxsplit=1)[0]
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
        # Waiting for a function evaluates it in the page, which the pages' own policy forbids.
        context = browser.new_context(viewport={"width": 1280, "height": 900}, bypass_csp=True)
        page = context.new_page()
        page.goto(link)
        page.get_by_role("button").first.click()
        page.locator("#live[data-state='on']").wait_for()
        known = places(page, origin)
        page.close()
        context.add_init_script(USABLE)
        context.add_init_script(DRAWN)
        print("| page | seconds, the middle of five | slowest |\n|---|---|---|")
        for kind, paths, mark in (("", () if only_scenes else PAGES, "usableAt"), ("3D: ", SCENES, "drawnAt")):
            for path in paths:
                found = seconds(context, origin + path.format(**known), mark)
                print(f"| {kind}{path} | {statistics.median(found):.2f} | {max(found):.2f} |", flush=True)
        browser.close()


if __name__ == "__main__":
    main()
