"""What README and docs print is run as printed: blocks of Python, and the first result."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from dashpot.app.cli import run

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def blocks(language: str) -> list[tuple[str, str]]:
    """(document and line, text) of every block in a language."""
    found = []
    for document in DOCUMENTS:
        text = document.read_text(encoding="utf-8")
        for match in re.finditer(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
            line = text[: match.start()].count("\n") + 2
            found.append((f"{document.name}:{line}", match[1]))
    return found


PYTHON = blocks("python")


def test_there_is_a_quick_start_in_readme_and_docs() -> None:
    assert {place.partition(":")[0] for place, _ in PYTHON} >= {"README.md", "howto.md"}


@pytest.mark.parametrize("text", [pytest.param(text, id=place) for place, text in PYTHON])
def test_blocks_of_python_run_as_printed(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    exec(compile(text, "documentation", "exec"), {})


def test_the_first_result_is_what_the_commands_print(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also what the quick start in Python prints: the same rig, test and seed."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    section = readme[readme.index("## First result") : readme.index("## Your own rig")]
    commands = re.findall(r"^dashpot (.*)$", section, re.MULTILINE)
    table = section[section.index("parameter  value") :].partition("```")[0]
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    for command in commands:
        assert run(shlex.split(command)) == 0
    printed = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    for line in table.strip().splitlines():
        assert line in printed
