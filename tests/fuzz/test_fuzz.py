"""What the fuzzer has found stays mended, and a short run of it finds nothing; `python3 dev.py fuzz` runs for long."""

import contextlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dashpot.app import cli
from dashpot.data.readers import guarded
from tests.fuzz import __main__ as campaign
from tests.fuzz.cases import Case, made
from tests.fuzz.runner import READERS, Outcome, finding, outcome

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
KEPT = sorted((HERE / "findings").glob("*.json"))
SHORT = 60
PATIENT = 30.0  # s: the limit of a campaign on an idle machine is 5 s, and slower ones run these tests too


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("path", KEPT, ids=[path.stem for path in KEPT])
def test_findings_stay_mended(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.fuzz.runner.SECONDS", PATIENT)
    assert finding(Case.load(path)) is None


@pytest.mark.slow
def test_a_short_run_finds_nothing(tmp_path: Path) -> None:
    done = subprocess.run(
        [
            sys.executable, "-m", "tests.fuzz", "--inputs", str(SHORT), "--processes", "1", "--seed", "1989",
            "--keep", str(tmp_path),
        ],
        cwd=ROOT, capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{SHORT} inputs" in done.stdout


def test_a_case_depends_on_its_number_alone_and_survives_its_file(tmp_path: Path) -> None:
    for index in range(20):
        case = made(3, index)
        assert made(3, index) == case
        (tmp_path / "case.json").write_text(case.to_json(), encoding="ascii")
        assert Case.load(tmp_path / "case.json") == case


@pytest.mark.slow
def test_the_runner_sees_what_it_is_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each kind of fault, planted, is found."""
    case = Case(("identify", "rig.toml"), {"rig.toml": b"x = 1\n"})

    def planted(fault: object) -> str | None:
        monkeypatch.setattr(cli, "run", fault)
        return finding(case)

    def raises(_: object) -> int:
        raise ZeroDivisionError

    def spins(_: object) -> int:
        while True:
            pass

    def stops(_: object) -> int:
        with contextlib.suppress(KeyboardInterrupt):
            spins(_)
        return 130

    def deaf(_: object) -> int:
        with contextlib.suppress(KeyboardInterrupt):
            spins(_)
        return spins(_)

    def leaves_a_part(_: object) -> int:
        Path(".dashpot-1.part").write_text("", encoding="ascii")
        return stops(_)

    def ends_unseen(_: object) -> int:
        """Obedient to Ctrl-C, and done soon after it would come."""
        end = time.process_time() + 0.25
        with contextlib.suppress(KeyboardInterrupt):
            while time.process_time() < end:
                pass
            return 0
        return 130

    def stranger(_: object) -> int:
        os.write(2, b"it went past dashpot\n")
        return 0

    def writes(name: str, text: str) -> object:
        def run(_: object) -> int:
            Path(name).write_text(text, encoding="utf-8")
            return 0

        return run

    def prints(text: str, code: int = 2) -> object:
        def run(_: object) -> int:
            print(text, file=sys.stderr)
            return code

        return run

    assert planted(lambda _: 0) is None
    assert planted(raises) == "ZeroDivisionError in test_fuzz.py:raises"
    assert planted(lambda _: 1) == "exit code 1"
    assert planted(lambda _: 2) == "refused without a word"
    assert planted(writes("rig.toml", "other")) == "rig.toml was changed"
    assert planted(writes("out.json", '{\n"a": NaN}')) == "JSON: ValueError"
    assert planted(writes(".dashpot-1.part", "")) == "a temporary file is left"
    assert planted(prints("dashpot: \x1b[31mred")) == "control character on stderr"
    assert planted(prints("dashpot: line\n" * 50)) == "40 lines and more on stderr"
    assert planted(stranger) == "a library writes to stderr: it went past dashpot"
    assert planted(prints("dashpot: not enough memory; give fewer")) == "memory"
    monkeypatch.setattr("tests.fuzz.runner.SECONDS", 0.1)
    monkeypatch.setattr("tests.fuzz.runner.OBEYS", 0.1)
    assert planted(spins) == "KeyboardInterrupt in test_fuzz.py:spins"
    assert planted(deaf) == "deaf to Ctrl-C in test_fuzz.py:spins"
    assert planted(leaves_a_part) == "a temporary file is left"
    assert planted(stops) == "hang in test_fuzz.py:spins"  # not in less than what its command is granted
    assert planted(ends_unseen) == "no progress in identify"


def test_what_fails_without_the_guard_is_judged_behind_it(monkeypatch: pytest.MonkeyPatch) -> None:
    case = Case(("@data", "a.h5"), {"a.h5": b""})

    def fails(_: object) -> None:
        if not guarded.GUARDED or case.files["a.h5"]:
            raise ZeroDivisionError

    monkeypatch.setitem(READERS, "@data", fails)  # type: ignore[arg-type]
    assert outcome(case, guard=False).what is None
    case.files["a.h5"] = b"1"
    assert outcome(case, guard=False).what == "ZeroDivisionError in test_fuzz.py:fails"


@pytest.mark.parametrize(
    ("always", "found"), [(False, {}), (True, {"the process ended with -6": [*range(9)]})]
)
def test_a_case_that_ends_its_worker_is_tried_behind_the_guard(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, always: bool, found: dict[str, list[int]]
) -> None:
    def ends(_: Case, guard: bool) -> Outcome:
        if always or not guard:
            os.abort()
        return Outcome(None)

    monkeypatch.setattr(campaign, "outcome", ends)
    ran = campaign.Campaign(3, 0, 9, 2, None, tmp_path)
    assert ran.run() == bool(found)
    assert ran.done == 9
    assert {what: sorted(indices) for what, indices in ran.found.items()} == found


def test_kept_findings_are_small() -> None:
    for path in KEPT:
        assert path.stat().st_size < 60_000, path
        json.loads(path.read_text(encoding="ascii"))
