#!/usr/bin/env bash
# See that there is a Chromium for the browser tests: one on the PATH, Debian's package, or Playwright's own.
# None of these is an error here; the tests skip with one line, unless SCATOLA_TEST_REQUIRE_SERVICES=1.
set -u
for name in chromium chromium-browser google-chrome; do
  command -v "$name" >/dev/null 2>&1 && exit 0
done
ls "${PLAYWRIGHT_BROWSERS_PATH:-$HOME/.cache/ms-playwright}"/chromium* >/dev/null 2>&1 && exit 0
log=$(mktemp)
if command -v apt-get >/dev/null 2>&1 && [ "$(id -u)" = 0 ]; then
  { apt-get update && apt-get install -y --no-install-recommends chromium fonts-dejavu-core; } >"$log" 2>&1 && exit 0
fi
.venv/bin/playwright install chromium-headless-shell >>"$log" 2>&1 && exit 0
echo "no Chromium could be had (log: $log); browser tests will be skipped" >&2
exit 0
