"""The screenshots of docs/images, taken again: `python -m tests.pictures`, after `python3 dev.py docs`."""

import contextlib
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from dashpot.app.cli import run
from tests.browser import chromium, served
from tests.two_masses import UNDETERMINED

ROOT = Path(__file__).parents[1]
IMAGES, SITE = ROOT / "docs" / "images", ROOT / "docs" / "_build" / "html"
METHODS, SHAKE_TABLE = ROOT / "examples" / "05_methods", ROOT / "examples" / "02_shake_table"
PHONE = 390  # px; narrower than a window can be, so a frame in a page


def take(address: str, width: int, height: int, to: Path, scratch: Path) -> None:
    """One page as a PNG file of that size."""
    browser = chromium()
    assert browser is not None, "there is no Chromium on this machine"
    command = [
        browser, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--hide-scrollbars",
        "--disable-background-networking", f"--user-data-dir={scratch / 'profile'}", f"--screenshot={to}",
        f"--window-size={max(width, 500)},{height}", address,
    ]  # fmt: skip
    subprocess.run(command, capture_output=True, timeout=120, check=True)
    with Image.open(to) as picture:
        picture.crop((0, 0, width, height)).save(to, optimize=True)


def take_on_a_phone(address: str, to: Path, scratch: Path) -> None:
    """One page as a phone shows it."""
    frame = f'<iframe src="{address}" style="width:{PHONE}px;height:844px;border:0">'
    (scratch / "frame.html").write_text(f'<!DOCTYPE html><body style="margin:0">{frame}</iframe>')
    take((scratch / "frame.html").as_uri(), PHONE, 844, to, scratch)


def take_the_page(scratch: Path) -> None:
    """What `dashpot serve` shows of a rig that does not fit, wide and on a phone."""
    from playwright.sync_api import sync_playwright

    from tests.page.test_page import Server

    (scratch / "measurements").mkdir()
    server = Server(scratch / "measurements")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 860})
        page.set_default_timeout(300_000)
        page.goto(server.address)
        page.get_by_label("Rig file").set_input_files(SHAKE_TABLE / "rig.toml")
        page.get_by_label("Data files").set_input_files(SHAKE_TABLE / "amplitudes.csv")
        page.get_by_role("table", name="Channels").wait_for()
        page.get_by_role("button", name="Identify").click()
        page.get_by_role("table", name="Modes").wait_for()
        page.get_by_role("progressbar", name="Progress").wait_for(state="hidden")
        page.mouse.move(0, 0)
        for name, width, height in (("page.png", 1280, 860), ("page_phone.png", PHONE, 844)):
            page.set_viewport_size({"width": width, "height": height})
            page.wait_for_timeout(1000)
            page.screenshot(path=IMAGES / name)
            with Image.open(IMAGES / name) as picture:
                picture.quantize(64).save(IMAGES / name, optimize=True)
        browser.close()
    server.kill()


def main() -> None:
    """Take all of them."""
    with tempfile.TemporaryDirectory() as folder:
        take_the_page(Path(folder))
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        with served(SITE) as address:
            take(f"{address}/gallery/01_first_fit/index.html", 1400, 1000, IMAGES / "site_wide.png", scratch)
            take_on_a_phone(f"{address}/tutorial.html", IMAGES / "site_phone.png", scratch)
        (scratch / "rig.toml").write_text(
            f'name = "A mass between two walls"\n{UNDETERMINED}', encoding="utf-8"
        )
        with contextlib.chdir(METHODS):  # the report names its files as they were typed
            run(["identify", "rig.toml", "amplitudes.csv", "-q", "--report", str(scratch / "report.html")])
        with contextlib.chdir(SHAKE_TABLE):
            run(["identify", "rig.toml", "amplitudes.csv", "-q", "--report", str(scratch / "misfit.html")])
        run(["check", str(scratch / "rig.toml"), "--report", str(scratch / "undetermined.html")])
        take((scratch / "report.html").as_uri(), 1400, 1000, IMAGES / "report.png", scratch)
        misfit = (scratch / "misfit.html").as_uri()
        take(misfit, 1280, 1000, IMAGES / "report_misfit.png", scratch)
        take_on_a_phone(misfit, IMAGES / "report_phone.png", scratch)
        undetermined = IMAGES / "report_undetermined.png"
        take((scratch / "undetermined.html").as_uri(), 1000, 460, undetermined, scratch)


if __name__ == "__main__":
    sys.exit(main())
