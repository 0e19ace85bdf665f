"""A page opened in headless Chromium, and what it finds of it."""

import json
import re
import subprocess
import tempfile
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from tests.browser import LIGHT, chromium

CHROMIUM = chromium()
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars",
)  # fmt: skip
# Nothing may be asked for: what the page would request is refused and reported.
POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'unsafe-inline'"
PROBE = """
<meta http-equiv="Content-Security-Policy" content="%POLICY%">
<script>
const wrong = [];
addEventListener('error', e => wrong.push('error: ' + e.message));
addEventListener('securitypolicyviolation', e => wrong.push('request: ' + e.blockedURI));
console.error = (...words) => wrong.push('console: ' + words.join(' '));
%LIGHT%
function background(node) {
  for (; node; node = node.parentElement) {
    const c = numbers(getComputedStyle(node).backgroundColor);
    if (c.length === 3 || c[3] > 0.5) return c;
  }
  return [255, 255, 255];
}
addEventListener('load', () => {
  let least = 99, where = '';
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode.parentElement;
    if (!walker.currentNode.data.trim() || ['STYLE', 'SCRIPT', 'title', 'desc'].includes(node.tagName)) continue;
    const style = getComputedStyle(node), drawn = node.namespaceURI.endsWith('svg');
    const front = numbers(drawn ? style.fill : style.color);
    if (drawn && light(front) > 0.9) continue;  // on dark fields of a heat map
    const [a, b] = [light(front), light(background(node))];
    const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (contrast < least) { least = contrast; where = walker.currentNode.data.trim(); }
  }
  const named = e => (e.getAttribute('alt') || e.getAttribute('aria-label') || '').trim();
  const timing = performance.getEntriesByType('navigation')[0];
  const result = {
    wrong, width: innerWidth, needed: document.documentElement.scrollWidth, least, where,
    unnamed: [...document.querySelectorAll('img, svg')].filter(e => !named(e)).length,
    pictures: document.querySelectorAll('img, svg').length,
    requests: performance.getEntriesByType('resource').filter(e => !e.name.startsWith('data:')).map(e => e.name),
    loaded_ms: timing.loadEventStart, tried: (() => { %SCRIPT% })(),
  };
  const text = 'RESULT' + encodeURIComponent(JSON.stringify(result)) + 'END';
  if (parent === window) document.title = text; else parent.postMessage(text, '*');
});
</script>
"""
FRAME = """<!DOCTYPE html><title>waiting</title>
<script>addEventListener('message', e => { document.title = e.data; });</script>
<iframe src="page.html" style="width: %WIDTH%px; height: 2000px; border: 0"></iframe>
"""
NARROWEST = 500  # px that a window has at least; narrower pages are looked at in a frame


def probed(page: Path, width: int, script: str = "") -> dict[str, Any]:
    """What the browser finds of a page at that width, and as 'tried' what a script in it returns."""
    assert CHROMIUM is not None
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "page.html"
        html = page.read_text(encoding="utf-8")
        probe = PROBE.replace("%POLICY%", POLICY).replace("%LIGHT%", LIGHT).replace("%SCRIPT%", script)
        copy.write_text(html.replace("<head>", f"<head>{probe}", 1), encoding="utf-8")
        more = []
        if width < NARROWEST:
            copy = Path(folder) / "frame.html"
            copy.write_text(FRAME.replace("%WIDTH%", str(width)), encoding="utf-8")
            more = ["--virtual-time-budget=5000"]
        command = [
            CHROMIUM, *FLAGS, *more, f"--user-data-dir={folder}/profile", f"--window-size={width},1200", "--dump-dom",
            copy.as_uri(),
        ]  # fmt: skip
        out = subprocess.run(command, capture_output=True, timeout=120, check=True).stdout.decode("utf-8")
    found = re.search("<title>RESULT(.*?)END</title>", out)
    return json.loads(unquote(found[1]))
