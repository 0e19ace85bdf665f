"""Which numeric constants decide anything: each one halved and doubled in place, over a set of decisions.

python3 dev.py bench thresholds                    all constants of check, conditioning and estimate
python3 dev.py bench thresholds --only check/verdict.py:FELT data/conditioning
… --state FILE        what has been found, kept after each constant and gone on with (default: in the temporary folder)
… --seconds 280       stop after so long; run again to go on
… --report            what the state holds, without running anything

The decisions are quick journeys (`journeys.py`) and rigs with a known mistake (`faults.py`), in this process.  A
constant is tried on those that call a function which names it: on the quickest of each kind.  Not seen: constants
that are the defaults of parameters, and those that other constants were computed of when their module was imported.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import json
import re
import sys
import tempfile
import time
import types
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import _journey_list as listed
import faults
import journeys

SOURCE = listed.ROOT / "src" / "dashpot"
PACKAGES = ("check", "data/conditioning", "data/noise.py", "data/periods.py", "estimate")
SLOWEST = 1.5  # s of a journey of the set
EACH = 10  # decisions on which a constant is tried, at most,
SECONDS = 5.0  # and how long they may take together
FAULTS = 12


def constants() -> dict[str, tuple[str, str, Any]]:
    """`file:NAME` → module, name, value of all numbers and tuples of numbers at the top of modules."""
    found = {}
    for path in sorted(SOURCE.rglob("*.py")):
        file = path.relative_to(SOURCE).as_posix()
        if not file.startswith(PACKAGES):
            continue
        module = "dashpot." + file.removesuffix(".py").replace("/", ".")
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                target = node.targets[0] if isinstance(node, ast.Assign) else node.target
                if isinstance(target, ast.Name) and _is_number(node.value):
                    value = getattr(importlib.import_module(module), target.id)
                    found[f"{file}:{target.id}"] = module, target.id, value
    return found


def _is_number(node: ast.AST) -> bool:
    if isinstance(node, ast.UnaryOp):
        return _is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return _is_number(node.left) and _is_number(node.right)
    if isinstance(node, ast.Tuple):
        return bool(node.elts) and all(map(_is_number, node.elts))
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float) and node.value is not True


def moved(value: Any, factor: float) -> Any:
    """A number, or each of a tuple, times the factor; whole ones stay whole."""
    if isinstance(value, tuple):
        return tuple(moved(each, factor) for each in value)
    return max(1, round(value * factor)) if isinstance(value, int) else value * factor


def holders(module: str, name: str) -> list[tuple[types.ModuleType, str]]:
    """The modules that hold a constant, and under which name: its own, and those that import it."""
    found = [(sys.modules[module], name)]
    for other, held in list(sys.modules.items()):
        if other.startswith("dashpot."):
            found += [
                (held, alias) for source, given, alias in imported(held) if (source, given) == (module, name)
            ]
    return found


@cache
def imported(module: types.ModuleType) -> list[tuple[str | None, str, str]]:
    """What a module imports at its top: from where, the name there, the name here."""
    file = Path(module.__file__ or "")
    tree = ast.parse(file.read_text(encoding="utf-8") if file.suffix == ".py" else "")
    nodes = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    return [(node.module, each.name, each.asname or each.name) for node in nodes for each in node.names]


def forget() -> None:
    """Empty what functions remember of earlier calls."""
    for name, module in list(sys.modules.items()):
        if name.startswith("dashpot"):
            for each in vars(module).values():
                if hasattr(each, "cache_clear"):
                    each.cache_clear()


# ---------------------------------------------------------------- decisions


def decisions() -> list[str]:
    """Ids of journeys, the quickest of each kind, and of faults."""
    quick = {id: r["seconds"] for id, r in journeys.reference().items() if r["seconds"] <= SLOWEST}
    kinds: Counter[str] = Counter()
    chosen = []
    for id in sorted(quick, key=quick.__getitem__):
        kind = re.sub(r"-\d.*", "", id)
        kinds[kind] += 1
        if kinds[kind] <= 12:
            chosen.append(id)
    return [*chosen, *(f"fault {seed}" for seed in range(FAULTS))]


def decided(id: str) -> Any:
    """What a decision comes to, to be compared by `journeys.differences`."""
    forget()
    if not id.startswith("fault "):
        return journeys.run(listed.journeys()[id])
    name, said = faults.blind(1000 + int(id.split()[1]), 4)
    return {"codes": [], "text": f"{name}: {said}", "files": {}}


def traced(id: str) -> tuple[Any, set[tuple[str, str]]]:
    """A decision, and the functions (file, name) that it called."""
    called: set[types.CodeType] = set()

    def note(frame: types.FrameType, event: str, argument: Any) -> None:
        if event == "call":
            called.add(frame.f_code)

    sys.setprofile(note)
    try:
        result = decided(id)
    finally:
        sys.setprofile(None)
    root = str(SOURCE)
    return result, {
        (code.co_filename, name)
        for code in called
        if code.co_filename.startswith(root)
        for name in _names(code)
    }


def _names(code: types.CodeType) -> Iterator[str]:
    """The global names that a function or one inside it reads."""
    yield from code.co_names
    for each in code.co_consts:
        if isinstance(each, types.CodeType):
            yield from _names(each)


# ---------------------------------------------------------------- the run


def run(state: dict[str, Any], only: list[str], until: float, keep: Path) -> None:
    """Go through the constants; each finding is written as it is made."""
    every = constants()
    state.setdefault("reach", {})
    state.setdefault("results", {})
    for id in decisions():
        if id not in state["reach"]:
            if time.monotonic() > until:
                return
            began = time.monotonic()
            result, names = traced(id)
            state["results"][id] = result | {"seconds": time.monotonic() - began}
            state["reach"][id] = sorted(
                f"{Path(file).relative_to(SOURCE).as_posix()} {name}" for file, name in names
            )
            keep.write_text(json.dumps(state), encoding="utf-8")
    reach = {id: set(names) for id, names in state["reach"].items()}
    took = {id: result["seconds"] for id, result in state["results"].items()}
    tolerance = journeys.Tolerance(strict=False)
    for key, (module, name, value) in every.items():
        known = state.setdefault("constants", {})
        if key in known or (only and not key.startswith(tuple(only))):
            continue
        held = holders(module, name)
        seen = {
            f"{Path(str(where.__file__)).relative_to(SOURCE).as_posix()} {alias}" for where, alias in held
        }
        ids = sorted((id for id in reach if reach[id] & seen), key=took.__getitem__)
        kinds = {re.sub(r"[- ]\d.*", "", id): id for id in reversed(ids)}
        first = sorted(kinds.values(), key=took.__getitem__)[:EACH]
        tried, together = [], 0.0
        for id in [*first, *(id for id in ids if id not in first)]:
            together += took[id]
            if len(tried) < EACH and (together <= SECONDS or not tried):
                tried.append(id)
        changes = []
        for factor in (0.5, 2.0):
            for where, alias in held:
                setattr(where, alias, moved(value, factor))
            try:
                for id in tried:
                    if time.monotonic() > until:
                        return
                    lines = journeys.differences(state["results"][id], decided(id), tolerance)
                    if lines:
                        changes.append(f"× {factor:g} {id}: {lines[0][:160]}")
                        break
            finally:
                for where, alias in held:
                    setattr(where, alias, value)
        known[key] = {"value": value, "tried": tried, "of": len(ids), "changes": changes}
        keep.write_text(json.dumps(state), encoding="utf-8")
        print(f"{key} = {value}: {len(tried)} of {len(ids)} decisions: {changes or 'nothing'}", flush=True)


def report(state: dict[str, Any]) -> None:
    """Constants that nothing reaches, that change nothing, and how many change something."""
    known = state.get("constants", {})
    groups = {
        "no decision of the set reaches them": [k for k, v in known.items() if not v["tried"]],
        "they change nothing": [k for k, v in known.items() if v["tried"] and not v["changes"]],
        "they change something": [k for k, v in known.items() if v["changes"]],
    }
    for title, keys in groups.items():
        print(f"\n{title}: {len(keys)}")
        for key in keys:
            print(f"  {key} = {known[key]['value']} ({len(known[key]['tried'])} of {known[key]['of']})")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="*", default=[], metavar="FILE:NAME")
    parser.add_argument("--state", type=Path, default=Path(tempfile.gettempdir()) / "dashpot_thresholds.json")
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--report", action="store_true")
    given = parser.parse_args()
    state = json.loads(given.state.read_text(encoding="utf-8")) if given.state.exists() else {}
    if not given.report:
        run(state, given.only, time.monotonic() + given.seconds, given.state)
    report(state)


if __name__ == "__main__":
    main()
