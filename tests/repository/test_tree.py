"""The tree: tests mirror the sources, modules stay short, and docs/architecture.md names what is there."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCE, UNIT = ROOT / "src" / "dashpot", ROOT / "tests" / "unit"
LONGEST = 400  # lines of a module
WHOLE = "whole"  # the folder of what belongs to no single module of a package


def test_every_unit_test_stands_where_its_module_does() -> None:
    astray = []
    for path in UNIT.rglob("test_*.py"):
        place = path.relative_to(UNIT)
        twin = SOURCE / place.parent / place.name.removeprefix("test_")
        whole = place.parent.name == WHOLE and (SOURCE / place.parent.parent).is_dir()
        if not (whole or twin.is_file() or twin.with_suffix("").is_dir()):
            astray.append(str(place))
    assert astray == []


def test_modules_are_short() -> None:
    lines = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in SOURCE.rglob("*.py")}
    assert {str(path) for path, count in lines.items() if count > LONGEST} == set()


def test_the_map_names_what_is_there() -> None:
    """Paths in backticks, from the package, from one of its packages or from the root of the repository."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([\w./]+(?:\.py|\.md|\.toml|/))`", text))
    folders = [ROOT, SOURCE, *(path for path in SOURCE.rglob("*") if path.is_dir())]
    assert {name for name in named if not any((folder / name).exists() for folder in folders)} == set()


def test_the_map_names_every_package() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    packages = {path.parent.name for path in SOURCE.glob("*/__init__.py")}
    assert {name for name in packages if f"`{name}/`" not in text} == set()
