"""The page in a browser: the journey from files to a report, as a person makes it."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.browser import chromium
from tests.reports import EXAMPLES

pytest.importorskip("nicegui", reason="the page needs NiceGUI: python3 dev.py test --long installs it")
sync_api = pytest.importorskip(
    "playwright.sync_api", reason="Playwright is not installed: python3 dev.py test --long does it"
)
pytestmark = pytest.mark.long

PATIENCE = 120_000.0  # ms, for what is computed on a busy machine
SHAKE_TABLE = EXAMPLES["shake_table"] / "rig.toml", EXAMPLES["shake_table"] / "amplitudes.csv"


class Server:
    """`dashpot serve` in a folder."""

    def __init__(self, folder: Path, port: int = 0) -> None:
        command = [sys.executable, "-m", "dashpot", "serve", str(folder), "--no-browser", "--port", str(port)]
        self.began = time.monotonic()
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        assert self.process.stdout is not None
        self.address = self.process.stdout.readline().strip()
        self.port = int(self.address.rpartition(":")[2].partition("/")[0])

    def kill(self) -> None:
        """End it as a power cut would."""
        self.process.send_signal(getattr(signal, "SIGKILL", signal.SIGTERM))
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    found = Server(tmp_path)
    yield found
    found.kill()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    place = os.environ.get("DASHPOT_BROWSER") or chromium()
    if place is None:
        pytest.skip("there is no Chromium: install it, or name it in DASHPOT_BROWSER")
    with sync_api.sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=place, args=["--no-sandbox"])
        yield found
        found.close()


@contextmanager
def opened(browser: Any, server: Server, **options: Any) -> Iterator[Any]:
    """The page in a browser of its own; it may ask no other host, and complain of nothing."""
    context = browser.new_context(**options)
    complaints: list[str] = []
    asked: list[str] = []
    page = context.new_page()
    page.set_default_timeout(PATIENCE)
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(server.address)
    yield page
    assert complaints == []
    own = (f"http://127.0.0.1:{server.port}/", f"ws://127.0.0.1:{server.port}/", "data:", "blob:")
    assert [url for url in asked if not url.startswith(own)] == []
    context.close()


def give(page: Any, rig: Path | None, *data: Path) -> None:
    if rig is not None:
        page.get_by_label("Rig file").set_input_files(rig)
    if data:
        page.get_by_label("Data files").set_input_files([*data])


def identified(page: Any) -> str:
    page.get_by_role("button", name="Identify").click()
    verdict = page.get_by_role("region", name="Verdict")
    verdict.wait_for()
    return str(verdict.inner_text())


def test_from_files_to_a_verdict_a_correction_and_a_report(
    browser: Any, server: Server, tmp_path: Path
) -> None:
    with opened(browser, server) as page:
        give(page, *SHAKE_TABLE)
        verdict = identified(page)
        assert "27.1 %" in verdict
        with page.expect_download() as report:
            page.get_by_role("button", name="Report").click()
        assert "Three-storey frame" in Path(report.value.path()).read_text(encoding="utf-8")
        with page.expect_download() as estimate:
            page.get_by_role("button", name="estimate.json").click()
        ours = json.loads(Path(estimate.value.path()).read_text(encoding="utf-8"))
        command = [sys.executable, "-m", "dashpot", "identify", *map(str, SHAKE_TABLE), "--json", "-"]
        theirs = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
        assert {**ours, "rig": None} == {**theirs, "rig": None}
        shown = page.get_by_role("table", name="Parameters").inner_text()
        for end in theirs["parameters"]["k1"]["interval95"]:
            assert f"{end:.0f}" in shown
        page.get_by_role("button", name="Apply").first.click()
        page.get_by_text("Stale").wait_for()
        assert "k_x3_base" in page.get_by_label("Text of the rig").input_value()
        page.get_by_text("Stale").wait_for(state="hidden")  # identified again
        page.get_by_role("button", name="Undo").click()
        page.get_by_text("Stale").wait_for()
        assert page.get_by_label("Text of the rig").input_value() == SHAKE_TABLE[0].read_text(
            encoding="utf-8"
        )
