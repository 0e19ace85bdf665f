"""The manual as a site: it builds without a warning, and its pages need nothing that does not stand beside them."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote, urldefrag

import pytest

from tests.browser import chromium, visits
from tests.documents import ROOT

pytestmark = pytest.mark.long
LEAST_CONTRAST = 4.5  # of text, WCAG 2, level AA
NEEDED = ("sphinx", "furo", "myst_nb", "latex2mathml")


class References(HTMLParser):
    """What a page loads, where it leads, and the places in it that others may lead to."""

    def __init__(self) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.leads: list[str] = []
        self.places: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {key: value or "" for key, value in attrs}
        self.places |= {given[key] for key in ("id", "name") if key in given}
        if tag == "link" and given.get("rel") in ("stylesheet", "icon", "preload"):
            self.loaded.append(given["href"])
        elif "src" in given:
            self.loaded.append(given["src"])
        elif tag == "a" and "href" in given:
            self.leads.append(given["href"])


def references(page: Path) -> References:
    found = References()
    found.feed(page.read_text(encoding="utf-8"))
    return found


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site; warnings are errors."""
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        pytest.skip(f"{', '.join(missing)} not installed: python3 dev.py docs brings them")
    built = tmp_path_factory.mktemp("site") / "html"
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", "docs", str(built)]
    done = subprocess.run(
        command,
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "MPLBACKEND": "Agg"},
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return built


def pages(site: Path) -> list[Path]:
    return sorted(path for path in site.rglob("*.html") if "_static" not in path.parts)


def test_pages_load_nothing_from_elsewhere_and_lead_somewhere(site: Path) -> None:
    everything = {page: references(page) for page in pages(site)}
    assert len(everything) > 50
    for page, found in everything.items():
        for target in found.loaded:
            assert "://" not in target, f"{page.name} loads {target}"
            assert target.startswith("data:") or (page.parent / unquote(target.partition("?")[0])).exists()
        for lead in found.leads:
            path, place = urldefrag(lead)
            if "://" in lead or lead.startswith("mailto:"):
                continue
            goal = (page.parent / unquote(path)).resolve() if path else page
            assert goal.exists(), f"{page.relative_to(site)} leads to {lead}"
            if place and goal in everything:
                assert unquote(place) in everything[goal].places, (
                    f"{page.relative_to(site)} leads to {lead}, which has no such place"
                )


def test_style_sheets_load_nothing_from_elsewhere(site: Path) -> None:
    for sheet in site.rglob("*.css"):
        text = re.sub(r"url\(['\"]?data:[^)]*\)", "", sheet.read_text(encoding="utf-8"))
        loaded = re.findall(r"@import[^;]*|url\([^)]*\)", text)
        assert not [target for target in loaded if "//" in target], sheet.name


def test_no_page_is_an_orphan_and_all_of_the_index_are_there(site: Path) -> None:
    index = references(site / "index.html")
    led = {unquote(urldefrag(lead)[0]) for lead in index.leads}
    for page in pages(site):
        name = page.relative_to(site).as_posix()
        if name not in ("index.html", "genindex.html", "search.html", "py-modindex.html"):
            assert name in led or name.startswith("api/"), name


def test_pages_in_a_browser(site: Path) -> None:
    """No request to elsewhere, no error, no page wider than its window, no picture without words, enough contrast."""
    browser = chromium()
    if browser is None:
        pytest.skip("there is no Chromium on this machine (apt-get install chromium)")
    names = [page.relative_to(site).as_posix() for page in pages(site)]
    found, console = visits(browser, site, names, (1400, 390))
    assert len(found) == 2 * len(names)
    assert console == []
    for visit in found:
        place = f"{visit['page']} at {visit['width']} px"
        assert visit["outside"] == [], place
        assert visit["nameless"] == [], place
        assert visit["broken"] == [], place
        assert visit["scroll"] <= visit["shown"] + 1, f"{place}: {visit['scroll']} wide"
        assert visit["title"], place
        for theme in ("light", "dark"):
            assert visit[theme]["least"] >= LEAST_CONTRAST, f"{place}, {theme}: {visit[theme]}"
