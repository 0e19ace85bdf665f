"""dev.py's pure functions, and its file and process handling in a temporary folder; no network."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import dev


@pytest.mark.parametrize("version", [(3, 11), (3, 11, 7, "final", 0), (3, 12, 0), (4, 0)])
def test_new_enough_pythons_pass(version: tuple[object, ...]) -> None:
    assert dev.version_complaint(version) is None


@pytest.mark.parametrize("version", [(3, 10, 13, "final", 0), (3, 9), (2, 7, 18)])
def test_old_pythons_get_one_line_that_names_both_versions(version: tuple[object, ...]) -> None:
    complaint = dev.version_complaint(version)
    assert complaint is not None
    assert "\n" not in complaint
    assert "3.11 or newer" in complaint
    assert f"this is {version[0]}.{version[1]}:" in complaint


@pytest.mark.parametrize(
    ("argv", "expected"),
    [
        (["test", "-k", "foo"], ("test", ["-k", "foo"])),
        (["run", "--help"], ("run", ["--help"])),
        (["run"], ("run", [])),
        (["lock", "--upgrade"], ("lock", ["--upgrade"])),
        (["--help"], ("help", [])),
    ],
)
def test_arguments_are_passed_through(argv: list[str], expected: tuple[str, list[str]]) -> None:
    assert dev.parse(argv) == expected


@pytest.mark.parametrize(
    ("argv", "named"), [([], "run"), (["tset"], "'tset'"), (["check", "--fix"], "--fix"), (["env", "x"], "x")]
)
def test_a_wrong_command_line_is_one_line_that_names_what_is_wrong(argv: list[str], named: str) -> None:
    with pytest.raises(dev.UsageError) as failure:
        dev.parse(argv)
    assert named in str(failure.value)
    assert "\n" not in str(failure.value)


def test_a_digest_sees_where_parts_end() -> None:
    assert dev.digest("ab", "c") != dev.digest("a", "bc")
    assert dev.digest("ab", b"c") == dev.digest("ab", "c")


def test_packages_stamp_follows_lock_minor_version_and_place() -> None:
    stamp = dev.packages_stamp(b"numpy==2", (3, 11, 7), "/here")
    assert stamp == dev.packages_stamp(b"numpy==2", (3, 11, 9), "/here")
    others = [
        (b"numpy==3", (3, 11, 7), "/here"),
        (b"numpy==2", (3, 12, 7), "/here"),
        (b"numpy==2", (3, 11, 7), "/there"),
    ]
    assert stamp not in {dev.packages_stamp(*other) for other in others}


def test_project_stamp_follows_metadata_but_not_the_settings_of_linters() -> None:
    project = '[project]\nname = "dashpot"\n[project.scripts]\ndashpot = "dashpot.app.cli:main"\n'
    stamp = dev.project_stamp(project)
    assert stamp == dev.project_stamp(project + "[tool.ruff]\nline-length = 80\n")
    assert stamp != dev.project_stamp(project.replace("cli:main", "cli:start"))


@pytest.mark.parametrize(
    ("output", "cure"),
    [
        (
            "WARNING: Retrying after connection broken by 'X'\nERROR: No matching distribution found for a==1",
            "network",
        ),
        (
            "ERROR: Could not find it\nERROR: No matching distribution found for numpy==2.5 (from -r x)",
            "numpy==2.5 for",
        ),
        ("ERROR: THESE PACKAGES DO NOT MATCH THE HASHES FROM THE REQUIREMENTS FILE.", "hash"),
        ("ERROR: Could not install: [Errno 28] No space left on device", "disk is full"),
        ("noise\nERROR: something of its own\nmore noise", "ERROR: something of its own"),
        ("", "pip failed"),
    ],
)
def test_pip_output_becomes_one_line(output: str, cure: str) -> None:
    assert cure in dev.pip_complaint(output)
    assert "\n" not in dev.pip_complaint(output)


def test_benchmarks_are_chosen_by_name_and_keep_their_options() -> None:
    assert dev.split_bench([], ["a", "b"]) == (["a", "b"], [])
    assert dev.split_bench(["b", "--runs", "3"], ["a", "b"]) == (["b"], ["--runs", "3"])
    assert dev.split_bench(["benchmarks/b.py"], ["a", "b"]) == (["b"], [])
    with pytest.raises(dev.UsageError, match="'c': there are a, b"):
        dev.split_bench(["c"], ["a", "b"])


def test_an_older_processor_lacks_what_this_one_has() -> None:
    assert dev.older_processor({"sse2", "avx2", "avx512f"}) == {
        "OPENBLAS_CORETYPE": "Haswell", "DASHPOT_KERNEL_SET": "avx2",
    }  # fmt: skip
    assert dev.older_processor({"sse2", "avx2"})["DASHPOT_KERNEL_SET"] == "baseline"
    with pytest.raises(dev.SetupError, match="--older"):
        dev.older_processor({"asimd"})


def test_a_child_does_not_inherit_other_packages() -> None:
    made = dev.child_environment(
        {"PYTHONPATH": "/elsewhere", "PIP_TARGET": "/x", "HOME": "/h"}, {"OMP_NUM_THREADS": "1"}
    )
    assert "PYTHONPATH" not in made
    assert "PIP_TARGET" not in made
    assert (made["HOME"], made["OMP_NUM_THREADS"]) == ("/h", "1")


def test_processes_of_tests_keep_their_bytecode(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    code = "import sys; raise SystemExit(sys.dont_write_bytecode or sys.pycache_prefix is None)"
    assert dev.call([sys.executable, "-c", code], **dev.TESTED) == 0


def test_a_cut_or_missing_stamp_counts_as_none(tmp_path: Path) -> None:
    path = tmp_path / "stamp.json"
    assert dev.read_stamp(path) == {}
    dev.write_stamp(path, {"packages": "abc"})
    assert dev.read_stamp(path) == {"packages": "abc"}
    path.write_text(path.read_text()[:8])
    assert dev.read_stamp(path) == {}
    path.write_text(json.dumps(["abc"]))
    assert dev.read_stamp(path) == {}


@pytest.mark.parametrize("file", [dev.LOCKED, dev.RUN_LOCKED, dev.PEERS_LOCKED], ids=lambda path: path.name)
def test_lock_files_pin_and_hash_every_package_and_name_no_place(file: Path) -> None:
    text = file.read_text()
    assert dev.addresses_in(text) == []
    packages = text.replace("\\\n", " ").strip().splitlines()
    assert packages
    assert [line for line in packages if "==" not in line or "--hash=sha256:" not in line] == []


def test_places_in_a_lock_file_are_found() -> None:
    lines = ["--index-url https://example.org/simple", "a @ file:///tmp/a.whl", "--find-links wheels"]
    assert dev.addresses_in("\n".join(["a==1 \\", "    --hash=sha256:00", *lines])) == lines


@pytest.fixture
def clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A clone of nothing but its metadata, whose environment is made by nobody."""
    (tmp_path / "pyproject.toml").write_text("[project]\n")
    for name in ("STAMP", "KERNEL_STAMP", "KERNEL_LOG"):
        monkeypatch.setattr(dev, name, tmp_path / getattr(dev, name).name)
    monkeypatch.setattr(dev, "ROOT", tmp_path)
    monkeypatch.setattr(dev, "VENV", tmp_path / "venv")
    monkeypatch.setattr(dev, "PYTHON", tmp_path / "venv" / "python")
    monkeypatch.setattr(dev, "find_compiler", lambda: "c++")
    monkeypatch.setattr(dev, "quietly", lambda _: "")
    return tmp_path


def test_a_run_begins_with_what_it_needs_and_the_rest_is_added_to_it(
    clone: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[object] = []

    def make_venv(place: Path) -> None:
        done.append("made")
        place.mkdir()
        dev.PYTHON.touch()

    def pip(_: Path, *words: object) -> None:
        if "-e" not in words:
            done.append(words[-1])

    monkeypatch.setattr(dev, "make_venv", make_venv)
    monkeypatch.setattr(dev, "pip", pip)
    for begin in (True, True, False, True, False):
        dev.make_environment(begin=begin)
    assert done == ["made", dev.RUN_LOCKED, dev.LOCKED]


def test_the_rest_is_done_in_the_background_by_one_process(
    clone: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[list[str]] = []
    monkeypatch.setattr(dev.subprocess, "Popen", lambda command, **_: begun.append(command))
    dev.VENV.mkdir()
    dev.PYTHON.touch()
    dev.write_stamp(dev.STAMP, dev.wanted_stamp(dev.RUN_LOCKED))
    dev.finish_in_background()
    assert [command[-1] for command in begun] == ["env"]
    with dev.only_one(clone / ".venv.lock"):
        dev.finish_in_background()
    dev.write_stamp(dev.STAMP, dev.wanted_stamp(dev.LOCKED))
    dev.write_stamp(dev.KERNEL_STAMP, dev.wanted_kernel("c++"))
    dev.finish_in_background()
    assert len(begun) == 1


@pytest.mark.parametrize(("build", "tried"), [("time.sleep(9)", 2), ("raise SystemExit(1)", 1), ("", 1)])
def test_a_build_of_the_kernel_that_took_too_long_is_tried_again(
    build: str, tried: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[object] = []
    monkeypatch.setattr(dev, "ROOT", tmp_path)
    monkeypatch.setattr(dev, "KERNEL_STAMP", tmp_path / "stamp-kernel.json")
    monkeypatch.setattr(dev, "KERNEL_SECONDS", 5.0 if "sleep" not in build else 0.1)
    monkeypatch.setattr(dev, "find_compiler", lambda: "c++")
    quietly = dev.quietly

    def instead(command: list[object], seconds: float | None = None) -> str:
        if seconds is None:
            return ""
        begun.append(command)
        return quietly([sys.executable, "-c", f"import time; {build}"], seconds)

    monkeypatch.setattr(dev, "quietly", instead)
    dev.install_kernel()
    dev.install_kernel()
    assert len(begun) == tried


def test_exit_codes_are_passed_on() -> None:
    assert dev.call([sys.executable, "-c", "raise SystemExit(3)"]) == 3


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_killed_child_gives_the_shell_s_code() -> None:
    assert dev.call([sys.executable, "-c", "import os; os.kill(os.getpid(), 9)"]) == 137


@pytest.mark.skipif(sys.platform == "win32", reason="the file lock of Windows is not shared with children")
def test_set_up_is_done_by_one_at_a_time(tmp_path: Path) -> None:
    """Four processes read, wait and write one counter; without the lock they would overwrite each other."""
    counter = tmp_path / "counter"
    counter.write_text("0")
    code = (
        "import dev, pathlib, sys, time\n"
        "counter = pathlib.Path(sys.argv[1])\n"
        "with dev.only_one(counter.with_name('lock')):\n"
        "    seen = int(counter.read_text()); time.sleep(0.1); counter.write_text(str(seen + 1))\n"
    )
    children = [
        subprocess.Popen(
            [sys.executable, "-c", code, counter],
            cwd=dev.ROOT,
            env={**os.environ, "PYTHONPATH": str(dev.ROOT)},
        )
        for _ in range(4)
    ]
    assert [child.wait(timeout=300) for child in children] == [0] * 4
    assert counter.read_text() == "4"


@pytest.mark.slow
def test_the_kernel_carries_its_licence_and_says_what_a_build_lacks(tmp_path: Path) -> None:
    make = "from scikit_build_core.build import prepare_metadata_for_build_wheel as make; make(sys.argv[1])"
    subprocess.run([sys.executable, "-c", f"import sys; {make}", tmp_path], cwd=dev.KERNELS, check=True)
    (made,) = tmp_path.glob("*.dist-info")
    assert (made / "licenses" / "LICENSE").read_bytes() == (dev.ROOT / "LICENSE").read_bytes()
    assert {"Keywords:", "Classifier:"} <= set((made / "METADATA").read_text("utf-8").split())
    build = "from scikit_build_core.build import build_wheel as make; make(sys.argv[1])"
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; {build}", tmp_path], cwd=dev.KERNELS, capture_output=True, text=True,
        env={"PATH": str(dev.BIN), "CXX": str(tmp_path / "none")},
    )  # fmt: skip
    assert done.returncode
    assert "no C++ compiler: install one" in " ".join((done.stdout + done.stderr).split())


def test_the_extra_takes_the_kernel_of_this_copy() -> None:
    tables = [
        tomllib.loads(path.read_text("utf-8"))["project"]
        for path in (dev.ROOT / "pyproject.toml", dev.KERNELS / "pyproject.toml")
    ]
    (wanted,) = map(Requirement, tables[0]["optional-dependencies"]["fast"])
    assert wanted.name == tables[1]["name"]
    assert wanted.specifier.contains(tables[1]["version"])
