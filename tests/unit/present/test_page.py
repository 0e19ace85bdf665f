"""Reports as a browser shows them: nothing asked for, no error, no overflow, alternatives, contrast; and in print."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from dashpot.app.cli import run
from dashpot.app.report_files import write_report
from tests.reports import METHODS, REPORTS, make_reports
from tests.unit.present.browser import CHROMIUM, probed

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium or Chrome to open pages with"),
]
PDF_TEXT = shutil.which("pdftotext")
LEAST_CONTRAST = 4.5  # WCAG 2, level AA
WIDE = ("misfit", "design", "study")  # looked at in a wide window too, which leaves more room than a phone


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All reports as NAME.html."""
    made = tmp_path_factory.mktemp("reports")
    make_reports(made)
    return made


@pytest.mark.parametrize(
    ("name", "width"), [*((name, 390) for name in REPORTS), *((name, 1400) for name in WIDE)]
)
def test_pages_ask_for_nothing_and_can_be_read(folder: Path, name: str, width: int) -> None:
    found = probed(folder / f"{name}.html", width)
    assert found["wrong"] == []
    assert found["requests"] == []
    assert found["width"] == width
    assert found["needed"] <= width, "the page is wider than the window"
    assert found["pictures"] > 0
    assert found["unnamed"] == 0
    assert found["least"] >= LEAST_CONTRAST, found["where"]
    assert (folder / f"{name}.html").stat().st_size < 2 * 2**20


def test_the_probe_sees_what_is_wrong(tmp_path: Path) -> None:
    bad = tmp_path / "bad.html"
    bad.write_text(
        '<!DOCTYPE html><html><head></head><body><img src="https://example.org/x.png"><p style="color:#999">pale</p>'
        '<div style="width:3000px">wide</div><script>console.error("told"); nothing.here();</script></body></html>',
        encoding="utf-8",
    )
    found = probed(bad, 1400)
    assert {word.partition(":")[0] for word in found["wrong"]} >= {"error", "request", "console"}
    assert found["needed"] > 1400
    assert found["unnamed"] == 1
    assert found["least"] < LEAST_CONTRAST


# Points at the third dot of the first panel, drags over half of the panel, and goes back.
POINTING = """
const svg = document.querySelector('svg[data-panels]'), panel = JSON.parse(svg.dataset.panels)[0];
const [left, top, width, height] = panel.box, dots = panel.series.find(s => s.kind === 'points');
const figure = svg.closest('figure'), values = figure.querySelector('.values'), button = figure.querySelector('button');
const send = (name, x, y, to = svg) => {
  const at = new DOMPoint(x, y).matrixTransform(svg.getScreenCTM());
  to.dispatchEvent(new PointerEvent(name, { clientX: at.x, clientY: at.y, bubbles: true, pointerType: 'mouse' }));
};
const ticks = () => [...svg.querySelectorAll('.told text')].map(node => node.textContent);
const place = f => left + width * (Math.log10(f) - Math.log10(panel.x.limits[0])) /
  (Math.log10(panel.x.limits[1]) - Math.log10(panel.x.limits[0]));
const before = svg.innerHTML;
send('pointermove', place(dots.x[2]) + 1, top + height / 2);
const told = [...values.children].map(node => node.textContent);
send('pointerdown', left + width / 2, top + height / 2);
send('pointermove', left + width, top + height / 2);
send('pointerup', left + width, top + height / 2, window);
const zoomed = ticks(), shown = !button.hidden;
button.click();
svg.dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowRight' }));
const keyed = [...values.children].map(node => node.textContent);
svg.blur(); svg.dispatchEvent(new Event('blur'));
const numbers = text => (text.match(/ [xyd]="[^"]*"/g) || []).join(' ').match(/-?[\\d.]+/g).map(Number);
const [a, b] = [numbers(before), numbers(svg.innerHTML)];
return { told, zoomed, shown, keyed, hidden: button.hidden, limits: panel.x.limits, dot: [dots.x[2], dots.y[2]],
         first: dots.x[0], moved: a.length === b.length ? Math.max(...a.map((v, k) => Math.abs(v - b[k]))) : -1 };
"""


def told(text: str) -> list[float]:
    """The numbers of a line, behind the name that it begins with."""
    content = text.partition(": ")[2].replace("\N{MINUS SIGN}", "-")
    return [float(number) for number in re.findall(r"-?\d[\d.]*(?:e-?\d+)?", content)]


def test_figures_tell_values_and_zoom(folder: Path) -> None:
    found = probed(folder / "fits.html", 1400, POINTING)
    assert found["wrong"] == []
    tried = found["tried"]
    frequency, size = tried["dot"]
    assert tried["told"][0] == f"{frequency:.4g} Hz"
    measured, model, band = tried["told"][1:]
    value, low, high = told(measured)
    assert value == pytest.approx(size, rel=1e-3)
    assert low < size < high
    (curve,), edges = told(model), told(band)
    assert edges[0] <= curve <= edges[1]
    assert abs(curve - size) < 2 * (high - low)
    assert tried["shown"]
    assert tried["hidden"]
    middle = (tried["limits"][0] * tried["limits"][1]) ** 0.5
    ticks = [float(text) for text in tried["zoomed"] if re.fullmatch(r"[\d.]+", text)]
    assert len([value for value in ticks if middle <= value <= tried["limits"][1]]) >= 2
    assert tried["keyed"][0] == f"{tried['first']:.4g} Hz"
    assert 0 <= tried["moved"] < 0.01, "what is drawn does not come back"


# Whether the modes move, and what their button does.
STOPPING = """
const svg = [...document.querySelectorAll('svg')].find(each => each.querySelector('animate'));
const button = document.querySelector('.motion button'), words = [button.textContent];
const shape = [...svg.querySelectorAll('.moving path')].find(each => each.querySelector('animate'));
const moves = new Set(shape.querySelector('animate').getAttribute('values').split(';')).size;
const running = !svg.animationsPaused();
button.click(); words.push(button.textContent);
const stopped = svg.animationsPaused();
button.click(); words.push(button.textContent);
return { moves, running, stopped, again: !svg.animationsPaused(), words,
         still: getComputedStyle(svg.querySelector('.still')).display };
"""


def test_modes_move_and_can_be_stopped(folder: Path) -> None:
    found = probed(folder / "fits.html", 1400, STOPPING)
    assert found["wrong"] == []
    tried = found["tried"]
    assert (tried["running"], tried["stopped"], tried["again"], tried["still"]) == (True, True, True, "none")
    assert tried["moves"] > 5  # places of one part
    assert tried["words"] == ["Stop the motion", "Let them move", "Stop the motion"]


def printed_pages(path: str) -> list[str]:
    """The text of each page of a PDF file."""
    assert PDF_TEXT is not None
    done = subprocess.run([PDF_TEXT, "-layout", path, "-"], capture_output=True, check=True)
    return done.stdout.decode().rstrip("\f").split("\f")


def test_print_has_numbered_pages(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["identify", *METHODS, "--report", "report.pdf", "-q"]) == 0
    content = Path("report.pdf").read_bytes()
    assert content.startswith(b"%PDF")
    assert len(re.findall(rb"/Type\s*/Page\b", content)) >= 2
    if PDF_TEXT is not None:
        assert re.search(r"page 1 of \d", printed_pages("report.pdf")[0])


@pytest.mark.skipif(PDF_TEXT is None, reason="there is no pdftotext on this machine")
@pytest.mark.parametrize("name", REPORTS)
def test_on_paper_the_answer_is_on_the_first_page_and_what_is_signed_on_one(
    folder: Path, tmp_path: Path, name: str
) -> None:
    """Nothing to sign stands apart from the command, the files and the checksums that the signature is for."""
    write_report(str(tmp_path / "r.pdf"), (folder / f"{name}.html").read_text(encoding="utf-8"))
    pages = printed_pages(str(tmp_path / "r.pdf"))
    assert all(len(page) > 200 for page in pages), "an empty page"
    last = pages[-1]
    assert all(text in last for text in ("How it was computed", "To repeat it", "Options:", "checked by"))
    assert "How it was computed" not in "".join(pages[:-1])
    first = re.sub(r"\s+", " ", pages[0])
    assert re.search(r"\d{4}-\d\d-\d\d \d\d:\d\d [+-]\d{4}(, from [^;]+)?; how it was computed", first)
    assert re.search(r"What next|Parameters", first)
