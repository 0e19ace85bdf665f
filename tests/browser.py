"""Pages in headless Chromium: what they ask for, what they complain of, how wide they are."""

import functools
import http.server
import json
import os
import re
import shutil
import subprocess
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
# Luminance of a colour and the numbers in its text (WCAG 2), for scripts in pages.
LIGHT = """
const curve = c => { c /= 255; return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4; };
const light = ([r, g, b]) => 0.2126 * curve(r) + 0.7152 * curve(g) + 0.0722 * curve(b);
const numbers = text => (text.match(/[\\d.]+/g) || []).map(Number);
"""
# Each page in a frame of each width, one after the other; what is found goes into the document, which is printed.
_VISIT = """<!DOCTYPE html><meta charset="utf-8"><title>visit</title><pre id="found">running</pre><script>
const pages = PAGES, widths = WIDTHS, found = [];
LIGHT
// The least contrast of text with what lies behind it (WCAG 2), and that text.
function contrast(inside) {
  let least = 99, where = "";
  const walker = inside.document.createTreeWalker(inside.document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode.parentElement;
    if (!walker.currentNode.data.trim() || node.closest("script, style, noscript, svg")) continue;
    if (!node.checkVisibility()) continue;
    let behind = [255, 255, 255];
    for (let at = node; at; at = at.parentElement) {
      const colour = numbers(inside.getComputedStyle(at).backgroundColor);
      if (colour.length === 3 || colour[3] > 0.5) { behind = colour; break; }
    }
    const [a, b] = [light(numbers(inside.getComputedStyle(node).color)), light(behind)];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < least) { least = ratio; where = walker.currentNode.data.trim().slice(0, 60); }
  }
  return { least, where };
}
function themed(inside, theme) {
  inside.document.body.dataset.theme = theme;
  return contrast(inside);
}
function visit(page, width) {
  return new Promise(resolve => {
    const frame = document.createElement("iframe");
    frame.style.cssText = `width:${width}px;height:900px;border:0`;
    frame.onload = () => setTimeout(() => {
      const inside = frame.contentWindow, root = inside.document.documentElement;
      const asked = inside.performance.getEntriesByType("resource").map(entry => entry.name);
      const images = [...inside.document.images];
      found.push({
        page, width, scroll: root.scrollWidth, shown: root.clientWidth,
        milliseconds: inside.performance.timing.domContentLoadedEventEnd - inside.performance.timing.navigationStart,
        outside: asked.filter(name => !name.startsWith(location.origin) && !name.startsWith("data:")),
        nameless: images.filter(image => !image.alt.trim() && image.getAttribute("role") !== "presentation")
          .map(image => image.src.slice(0, 120)),
        broken: images.filter(image => image.complete && !image.naturalWidth && image.loading !== "lazy")
          .map(image => image.src.slice(0, 120)),
        title: inside.document.title, light: themed(inside, "light"), dark: themed(inside, "dark"),
      });
      frame.remove();
      resolve();
    }, 100);
    frame.src = page;
    document.body.appendChild(frame);
  });
}
(async () => {
  for (const page of pages) for (const width of widths) await visit(page, width);
  document.getElementById("found").textContent = JSON.stringify(found);
})();
</script>"""


def chromium() -> str | None:
    """The browser of this machine."""
    return next((place for name in NAMES if (place := shutil.which(name))), None)


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """Address at which the files of a folder are served to this machine."""

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: Any) -> None:
            return

    class Server(http.server.ThreadingHTTPServer):
        def handle_error(self, request: Any, client_address: Any) -> None:
            return  # a page that is left before it is read to its end

    handler = functools.partial(Quiet, directory=str(folder))
    with Server(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}"
        finally:
            server.shutdown()


def visits(
    browser: str, folder: Path, pages: Sequence[str], widths: Sequence[int]
) -> tuple[list[dict[str, Any]], list[str]]:
    """What each page of a folder shows at each width, and the lines of the browser's console.

    Names of other machines lead nowhere, so that whatever a page asks of them fails and is told.
    """
    visit = folder / "visit-all-pages.html"
    visit.write_text(
        _VISIT.replace("LIGHT", LIGHT)
        .replace("PAGES", json.dumps(list(pages)))
        .replace("WIDTHS", json.dumps(list(widths)))
    )
    try:
        with served(folder) as address:
            done = subprocess.run(
                [
                    browser, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
                    "--disable-extensions", "--disable-background-networking", "--no-first-run",
                    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1", "--window-size=1500,1000",
                    "--enable-logging=stderr", f"--user-data-dir={folder.parent / 'profile'}",
                    f"--timeout={1000 * (20 + 2 * len(pages) * len(widths))}",
                    f"--virtual-time-budget={1000 * (20 + 2 * len(pages) * len(widths))}",
                    "--dump-dom", f"{address}/{visit.name}",
                ],
                capture_output=True, text=True, check=False, timeout=600,
                env={**os.environ, "HOME": str(folder.parent)},
            )  # fmt: skip
    finally:
        visit.unlink()
    text = re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.DOTALL)
    assert text is not None, done.stderr[-2000:]
    assert text[1] != "running", f"the browser did not finish\n{done.stderr[-2000:]}"
    unescaped = text[1].replace("&lt;", "<").replace("&gt;", ">").replace("&quot;", '"').replace("&amp;", "&")
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return json.loads(unescaped), console
