"""How long headless Chromium takes to open the manual's pages and a report of every kind, until they are painted.

    python3 dev.py docs
    python3 dev.py bench pages [--repeats 3]

Each page is opened in a frame 1280 px wide, all after another in one browser, `repeats` times; told are medians.
"""

from __future__ import annotations

import argparse
import functools
import http.server
import json
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.browser import chromium  # noqa: E402
from tests.reports import make_reports  # noqa: E402

SITE = ROOT / "docs" / "_build" / "html"
LONGEST_S = 900.0
VISIT = """<!DOCTYPE html><meta charset="utf-8"><title>visit</title><body><script>
const pages = PAGES, times = {};
const painted = () => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
function open(page) {
  return new Promise(done => {
    const frame = document.createElement("iframe"), begun = performance.now();
    frame.style.cssText = "width:1280px;height:900px;border:0";
    frame.onload = async () => {
      await painted();
      (times[page] ||= []).push(performance.now() - begun);
      frame.remove();
      done();
    };
    frame.src = page;
    document.body.append(frame);
  });
}
(async () => {
  for (let k = 0; k < REPEATS; k++) {
    for (const page of pages) await open(page);
    await fetch("/times", { method: "POST", body: JSON.stringify(times) });
  }
})();
</script></body>"""


def opening_times(folder: Path, pages: list[str], repeats: int, browser: str) -> dict[str, list[float]]:
    """Milliseconds from asking for each page of a folder to its paint, for each repeat."""
    received: list[dict[str, list[float]]] = []
    done = threading.Event()

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: Any) -> None:
            return

        def do_POST(self) -> None:
            received.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(204)
            self.end_headers()
            if len(received) == repeats:
                done.set()

    visit = folder / "visit.html"
    visit.write_text(VISIT.replace("PAGES", json.dumps(pages)).replace("REPEATS", str(repeats)))
    with http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(Handler, directory=folder)
    ) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        process = subprocess.Popen(
            [
                browser, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run",
                "--disable-background-networking", "--window-size=1400,1000", f"--user-data-dir={folder / 'profile'}",
                f"http://127.0.0.1:{server.server_address[1]}/{visit.name}",
            ],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            if not done.wait(LONGEST_S) and not received:
                raise SystemExit(f"the browser did not open all pages in {LONGEST_S:g} s")
        finally:
            process.terminate()
            process.wait()
            server.shutdown()
    return received[-1]


def main() -> int:
    """Print a table of the reports, and of the manual's slowest pages."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--repeats", type=int, default=3)
    repeats = options.parse_args().repeats
    browser = chromium()
    if browser is None or not SITE.is_dir():
        print("Chromium and the manual are needed: python3 dev.py docs")
        return 0
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        shutil.copytree(SITE, folder / "manual")
        (folder / "reports").mkdir()
        make_reports(folder / "reports")
        pages = sorted(
            path.relative_to(folder).as_posix()
            for path in folder.rglob("*.html")
            if "_static" not in path.parts
        )
        sizes = {page: (folder / page).stat().st_size / 1000 for page in pages}
        times = opening_times(folder, pages, repeats, browser)
    middle = {page: statistics.median(times[page]) for page in pages}
    print(f"{'page':42} {'kB':>6} {'ms':>6}")
    for page in pages:
        print(f"{page:42} {sizes[page]:6.0f} {middle[page]:6.0f}")
    for kind in ("manual", "reports"):
        of_kind = {page: ms for page, ms in middle.items() if page.startswith(kind)}
        slowest = max(of_kind, key=of_kind.__getitem__)
        print(
            f"{kind}: {len(of_kind)} pages, median {statistics.median(of_kind.values()):.0f} ms, "
            f"slowest {of_kind[slowest]:.0f} ms ({slowest})"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
