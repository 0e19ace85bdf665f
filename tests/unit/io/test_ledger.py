"""What is read and written in a run goes through one place."""

import ast
import re
from pathlib import Path

import pytest

import dashpot

SOURCES = Path(dashpot.__file__).parent
# Files of dashpot's own: the package's, those in the folder of a study, which its claim reads and writes, and those
# that other programs need for a moment, those of the page's sessions; and what the system says of a process.
OWN = {
    "app/serve/feed.py",
    "app/serve/guard.py",
    "app/serve/page.py",
    "app/serve/session.py",
    "export/fmu.py",
    "io/atomic.py",
    "present/words.py",
    "reproduce/yamane1989.py",
    "study/blocks.py",
    "study/montecarlo.py",
}
# Of an archive that has been opened through the ledger.
MEMBERS = ("archive.open(", "whole.open(", "self.h5py.h5o.open(")
READS = {"open", "read_bytes", "read_text", "memory_map"}
TOUCHES = re.compile(
    r"(open|(read|write)_(bytes|text)|memory_map|os\.replace|rename|te?mp|Temporary\w+)\(|tempfile"
)


@pytest.fixture(scope="module")
def calls() -> list[tuple[str, ast.Call]]:
    """All calls of modules in which something is opened, written or moved, with the places of the modules."""
    sources = {path: path.read_text(encoding="utf-8") for path in SOURCES.rglob("*.py")}
    return [
        (path.relative_to(SOURCES).as_posix(), node)
        for path, source in sources.items()
        if TOUCHES.search(source)
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Call)
    ]


def _name(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


@pytest.mark.slow
def test_every_file_is_opened_for_reading_through_the_ledger(calls: list[tuple[str, ast.Call]]) -> None:
    unnoted = []
    for place, call in calls:
        if place in OWN or _name(call) not in READS:
            continue
        text = ast.unparse(call)  # of bytes that are held already, where it names BytesIO
        if not any(
            word in text for word in ("noted(", "devnull", "/proc/", "BytesIO(")
        ) and not text.startswith(MEMBERS):
            unnoted.append(f"{place}:{call.lineno} {text[:80]}")
    assert unnoted == []


def test_no_file_is_written_but_by_the_one_writer(calls: list[tuple[str, ast.Call]]) -> None:
    others = []
    for place, call in calls:
        of = getattr(getattr(call.func, "value", None), "id", "")
        writes = isinstance(call.func, ast.Attribute) and (
            _name(call) in ("write_text", "write_bytes") or (of, _name(call)) == ("os", "replace")
        )
        makes = _name(call) in ("tempfile", "mkstemp", "NamedTemporaryFile", "rename")
        uploads = "app/serve/guard.py"  # written as they come
        if place not in ("io/atomic.py", uploads) and (writes or makes):
            others.append(f"{place}:{call.lineno} {ast.unparse(call)[:80]}")
    assert others == []
