"""A million identifications as one study: how long it takes, and that an interruption does not change a bit.

`python3 dev.py bench study`, or with `--total 1000000` the size that is claimed.  The same study runs twice: in one
go, and interrupted half way (Ctrl-C) and resumed; then every block and the summary are compared byte for byte.

"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

RIG = Path(__file__).parents[1] / "examples" / "07_studies" / "two_masses.toml"
CASES = Path(__file__).parents[1] / "examples" / "07_studies" / "yamane1989_tables.toml"
COMMAND = [
    sys.executable,
    "-c",
    "import sys; from dashpot.app.cli import main; sys.argv[0] = 'dashpot'; main()",
]


def write_study(folder: Path, total: int) -> Path:
    """oiv in the four cases of the paper at 10 %, total / 4 draws each."""
    text = CASES.read_text(encoding="utf-8")
    text = text[: text.index("[[grid]]")].replace("two_masses.toml", str(RIG))
    lines = [line for line in text.splitlines() if not line.startswith(("draws", "methods"))]
    head = [f"draws = {total // 4}", 'methods = ["oiv"]']
    path = folder / "million.toml"
    path.write_text(
        "\n".join([*head, *lines, "[[grid]]", "noise = 0.1", "samples = 56", ""]), encoding="utf-8"
    )
    return path


def run(study: Path, out: Path, processes: int, until: int | None = None) -> float:
    """Seconds of a run; with `until`, of one that is interrupted when so many blocks are there."""
    started = time.perf_counter()
    options = ["study", str(study), "--out", str(out), "--processes", str(processes), "-q"]
    process = subprocess.Popen(COMMAND + options, start_new_session=True, stderr=subprocess.DEVNULL)
    while process.poll() is None:
        time.sleep(0.5)
        if until is not None and sum(1 for _ in out.rglob("[0-9]*.parquet")) >= until:
            process.send_signal(signal.SIGINT)
            process.wait()
    if (process.returncode == 0) == (until is not None):
        raise SystemExit(f"the study ended with {process.returncode}")
    return time.perf_counter() - started


def digest(out: Path) -> str:
    """Of all that the study wrote, names and bytes."""
    total = hashlib.sha256()
    for path in sorted(path for path in out.rglob("*") if path.is_file()):
        total.update(str(path.relative_to(out)).encode() + b"\0" + path.read_bytes())
    return total.hexdigest()


def main() -> None:
    """Both runs, their times, and whether they agree."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--total", type=int, default=40_000, help="identifications")
    options.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    options.add_argument("--folder", type=Path, help="where to work; a temporary folder unless given")
    given = options.parse_args()
    folder = given.folder if given.folder is not None else Path(tempfile.mkdtemp(prefix="dashpot-study-"))
    folder.mkdir(parents=True, exist_ok=True)
    try:
        study = write_study(folder, given.total)
        whole = run(study, folder / "whole", given.processes)
        blocks = sum(1 for _ in (folder / "whole").rglob("[0-9]*.parquet"))
        first = run(study, folder / "cut", given.processes, until=blocks // 2)
        rest = run(study, folder / "cut", given.processes)
        same = digest(folder / "whole") == digest(folder / "cut")
        size = sum(path.stat().st_size for path in (folder / "whole").rglob("*.parquet")) / 1e6
        print(
            f"{given.total:,} identifications (oiv, 25 or 18 lines), {given.processes} processes, {blocks} blocks"
        )
        print(
            f"in one go       {whole / 60:6.2f} min   {1e3 * whole * given.processes / given.total:.2f} ms a piece"
        )
        print(f"interrupted     {first / 60:6.2f} min   at half of the blocks")
        print(f"resumed         {rest / 60:6.2f} min")
        print(
            f"on disk         {size:6.1f} MB    the two runs are {'the same to the bit' if same else 'DIFFERENT'}"
        )
        if not same:
            raise SystemExit(1)
    finally:
        if given.folder is None:
            shutil.rmtree(folder)


if __name__ == "__main__":
    main()
