"""What README, manual and examples print, run as printed.

Blocks of a page are taken in order, in a folder of their own that holds a copy of the examples:

    ```sh       commands, one after the other: dashpot, cd and cp in this process, python as another one;
                a comment "exits with 3" beside a command says with which code it ends
    ```python   one program a page, run where the commands are run
    ```{code-cell} ipython3
                a cell of a notebook, run in the folder of its page; what stands in its last line is shown
    ```text     directly below one of these: every line of it is printed by it; a line "…" stands for any
    ```toml     whose first line is "# name.toml": a file of that name

Everything else (```console among it) is not run.  A page that takes long says so by <!-- long -->.
"""

import ast
import contextlib
import re
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "docs" / "_ext"))

import page_commands  # noqa: E402, of docs/_ext

LONG = "<!-- long -->"
CELL = "{code-cell} ipython3"
_BLOCK = re.compile(
    r"^(?P<fence>`{3,})(?P<language>\w*|\{code-cell\} ipython3)\n(?P<text>.*?)^(?P=fence)$",
    re.MULTILINE | re.DOTALL,
)
_EXIT = re.compile(r"exits with (\d+)")


@dataclass(frozen=True)
class Block:
    """One fenced block: its language, its text, its first line in the page, whether it follows the one before."""

    language: str
    text: str
    line: int
    follows: bool


def pages() -> list[Path]:
    """README, the manual, the examples in order."""
    manual = sorted((ROOT / "docs").rglob("*.md"))
    made = {"_build", "_generated"}
    written = [p for p in manual if not made & set(p.parts) and p.parent.parent.name != "gallery"]
    return [ROOT / "README.md", *written, *sorted((ROOT / "examples").glob("*/README.md"))]


def name_of(page: Path) -> str:
    """How tests call a page."""
    return page.relative_to(ROOT).as_posix()


def blocks(page: Path) -> list[Block]:
    """All fenced blocks of a page."""
    text = page.read_text(encoding="utf-8")
    found = []
    end = 0
    for match in _BLOCK.finditer(text):
        follows = not text[end : match.start()].strip()
        found.append(Block(match["language"], match["text"], text[: match.start()].count("\n") + 2, follows))
        end = match.end()
    return found


def is_long(page: Path) -> bool:
    """Whether a page says that it takes long."""
    return LONG in page.read_text(encoding="utf-8")


def is_run(page: Path) -> bool:
    """Whether a page has something to run."""
    return any(block.language in ("sh", "python", CELL) for block in blocks(page))


def run_page(page: Path, folder: Path) -> None:
    """Run the blocks of a page in `folder`; AssertionError where a command fails or prints something else."""
    shutil.copytree(ROOT / "examples", folder / "examples")
    in_its_place = page.is_relative_to(ROOT / "examples") or CELL in page.read_text(encoding="utf-8")
    start = folder / page.relative_to(ROOT).parent if in_its_place else folder
    start.mkdir(exist_ok=True)
    namespace: dict[str, Any] = {"__name__": "documentation"}
    printed = ""
    with contextlib.chdir(start):
        for block in blocks(page):
            place = f"{name_of(page)}:{block.line}"
            if block.language == "sh":
                printed = "".join(_command(line, place) for line in page_commands.lines(block.text))
            elif block.language == "python":
                with page_commands.captured() as stream:
                    exec(compile("\n" * block.line + block.text, str(page), "exec"), namespace)
                printed = stream.getvalue()
            elif block.language == CELL:
                _run_cell(block, page, namespace)
            elif block.language == "toml" and (named := re.match(r"# ([\w.-]+\.toml)\s*\n", block.text)):
                Path(named[1]).write_text(block.text, encoding="utf-8")
            elif block.language == "text" and block.follows and printed:
                _compare(block.text, printed, place)
            if block.language not in ("sh", "python"):
                printed = ""


def _run_cell(block: Block, page: Path, namespace: dict[str, Any]) -> None:
    """Run a cell, and show the value of its last expression as a notebook does."""
    text = re.sub(r"^:tags:.*\n", "", block.text)
    *program, last = ast.parse("\n" * block.line + text, str(page)).body
    shown = isinstance(last, ast.Expr)
    exec(compile(ast.Module(program if shown else [*program, last], []), str(page), "exec"), namespace)
    if isinstance(last, ast.Expr):
        value = eval(compile(ast.Expression(last.value), str(page), "eval"), namespace)
        for show in ("_repr_html_", "_repr_svg_"):
            getattr(value, show, str)()


def _command(line: str, place: str) -> str:
    """What one command prints."""
    expected = int(match[1]) if (match := _EXIT.search(line.partition("#")[2])) else 0
    try:
        code, printed = page_commands.run_line(line)
    except ValueError as no_command:
        raise AssertionError(f"{place}: {no_command}") from no_command
    assert code == expected, f"{place}: {line}: exit code {code}\n{printed}"
    return printed


def _compare(expected: str, printed: str, place: str) -> None:
    lines = {line.rstrip() for line in printed.splitlines()}
    for k, line in enumerate(expected.splitlines()):
        wanted = line.rstrip()
        assert not wanted or wanted == "…" or wanted in lines, (
            f"{place}: line {k + 1} of the output is not printed:\n{wanted}\n--- printed:\n{printed}"
        )
