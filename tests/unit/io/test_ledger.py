"""What is read and written in a run goes through one place."""

from __future__ import annotations

import ast
from pathlib import Path

import dashpot

SOURCES = Path(dashpot.__file__).parent
# Files of dashpot's own: the package's, those in the folder of a study, which its claim reads and writes, and those
# that other programs need for a moment.
OWN = {
    "export/fmu/archive.py",
    "io/atomic.py",
    "io/lock.py",
    "io/scratch.py",
    "reproduce/yamane1989/printed.py",
    "study/runner.py",
    "study/store.py",
}
MEMBERS = ("archive.open(", "whole.open(")  # of an archive that has been opened through the ledger
READS = {"open", "read_bytes", "read_text", "memory_map"}


def _calls(tree: ast.AST) -> list[ast.Call]:
    return [node for node in ast.walk(tree) if isinstance(node, ast.Call)]


def _name(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def test_every_file_is_opened_for_reading_through_the_ledger() -> None:
    unnoted = []
    for path in SOURCES.rglob("*.py"):
        place = path.relative_to(SOURCES).as_posix()
        if place in OWN:
            continue
        for call in _calls(ast.parse(path.read_text(encoding="utf-8"))):
            if (
                _name(call) in READS
                and "noted(" not in ast.unparse(call)
                and "devnull" not in ast.unparse(call)
                and "BytesIO(" not in ast.unparse(call)  # what is held already
                and not ast.unparse(call).startswith(MEMBERS)
            ):
                unnoted.append(f"{place}:{call.lineno} {ast.unparse(call)[:80]}")
    assert unnoted == []


def test_no_file_is_written_but_by_the_one_writer() -> None:
    others = []
    for path in SOURCES.rglob("*.py"):
        place = path.relative_to(SOURCES).as_posix()
        if place in ("io/atomic.py", "io/scratch.py"):
            continue
        for call in _calls(ast.parse(path.read_text(encoding="utf-8"))):
            if _name(call) in ("tempfile", "mkstemp", "NamedTemporaryFile", "rename") or (
                isinstance(call.func, ast.Attribute)
                and (
                    call.func.attr in ("write_text", "write_bytes")
                    or (call.func.attr == "replace" and getattr(call.func.value, "id", "") == "os")
                )
            ):
                others.append(f"{place}:{call.lineno} {ast.unparse(call)[:80]}")
    assert others == []
