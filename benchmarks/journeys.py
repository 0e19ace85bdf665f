"""Journeys through every command, compared with what they gave when they were recorded.

python3 dev.py bench journeys                 all, differences printed, exit code 1 where there are any
python3 dev.py bench journeys --sample 40     a seeded sample of them
python3 dev.py bench journeys --only ID…      the named ones; PREFIX* takes all that begin so
python3 dev.py bench journeys --accept ID…    record the named ones again, after a change that was meant
python3 dev.py bench journeys --record        record all
                                              (both: once more as on an older processor; what then differs
                                              is left out of the tests)
… --numbers                                   leave sentences out: exit codes, numbers and codes alone
… --strict                                    tolerances of one machine: 1e-9 of an unknown's sd, rtol 1e-7
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import gzip
import io
import json
import logging
import math
import multiprocessing
import os
import re
import shlex
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")

import numpy as np  # noqa: E402, after the number of threads is set

sys.path[:0] = [str(Path(__file__).resolve().parent), str(Path(__file__).resolve().parents[1])]
import _journey_list as listed  # noqa: E402, beside this file

import dev  # noqa: E402

REFERENCE = Path(__file__).with_name("journeys.json.gz")
LONGEST = 40  # numbers of an array that are kept one by one; longer ones are kept as projections
SKIPPED = {
    "history",
    "iterations",
    "dashpot",
    "version",
    "fingerprint",
}  # how an answer was reached, and by what
NUMBER = re.compile(r"(?<![\w.])[-−+]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])", re.IGNORECASE)
WIDTH = "100"
LONG = 8.0  # s of processor time after which a journey is named: make it shorter
UNMADE, UNCAUGHT = 71, 70  # codes of a step that could not change its files, and of a traceback
Result = dict[str, Any]


# ---------------------------------------------------------------- run


def run(journey: listed.Journey) -> Result:
    """What a journey gives: exit codes, transcript, the files that its commands wrote."""
    began = time.process_time()
    codes: list[int] = []
    text = ""
    with tempfile.TemporaryDirectory(prefix="journey") as place, _surroundings(Path(place)):
        before: dict[str, tuple[int, int]] = {}
        for step in journey.steps:
            if callable(step):
                try:
                    step()
                except Exception as fault:  # its data are not there: the journey goes on, and shows it
                    codes.append(UNMADE)
                    text += f"! {type(fault).__name__}: {fault}\n"
                before = _stamps()
                continue
            code, printed = _command(step)
            codes.append(code)
            text += f"$ {' '.join(step)}\n{printed}\n"
        written = [name for name, stamp in _stamps().items() if before.get(name) != stamp]
        files = {name: shown for name in sorted(written) if (shown := _file(Path(name))) is not None}
        result = {"codes": codes, "text": text, "files": files}
        result = _scrubbed(result, place)
    return result | {"seconds": round(time.process_time() - began, 2)}


def _stamps() -> dict[str, tuple[int, int]]:
    found = (p for p in sorted(Path().rglob("*")) if p.is_file() and ".blocks" not in str(p))
    return {p.as_posix(): (p.stat().st_mtime_ns, p.stat().st_size) for p in found}


@contextlib.contextmanager
def _surroundings(folder: Path) -> Iterator[None]:
    """A folder, a width of the terminal, no colours; warnings are faults, as in the tests."""
    kept = dict(os.environ)
    os.environ.update(COLUMNS=WIDTH, LINES="40", NO_COLOR="1", TERM="dumb", MPLBACKEND="Agg")
    os.environ.pop("DASHPOT_TRACEBACK", None)
    logging.disable(logging.WARNING)
    try:
        with contextlib.chdir(folder), warnings.catch_warnings():
            warnings.simplefilter("error")
            yield
    finally:
        logging.disable(logging.NOTSET)
        os.environ.clear()
        os.environ.update(kept)


def _command(words: Iterable[str]) -> tuple[int, str]:
    """Exit code and output of a command of dashpot, or of a line of an example."""
    words = list(words)
    line = words[1] if words[:1] == ["line"] else shlex.join(["dashpot", *words])
    stream = io.StringIO()
    with contextlib.redirect_stdout(stream), contextlib.redirect_stderr(stream):
        try:
            code, printed = listed.page_commands.run_line(line)
        except SystemExit as end:
            code, printed = int(end.code or 0), ""
        except Exception:
            code, printed = UNCAUGHT, traceback.format_exc(limit=-1)
    return code, stream.getvalue() + printed


def _scrubbed(text: Any, folder: str) -> Any:
    """Without what no two runs share."""
    if isinstance(text, dict):
        return {k: _scrubbed(v, folder) for k, v in text.items()}
    if isinstance(text, list):
        return [_scrubbed(v, folder) for v in text]
    if not isinstance(text, str):
        return text
    for path in {str(Path(folder).resolve()), folder}:
        text = text.replace(f"/private{path}", "FOLDER").replace(path, "FOLDER")
    text = text.replace(str(listed.ROOT), "ROOT")
    text = re.sub(r"\b\d{4}-\d\d-\d\d(?:[T ]\d\d:\d\d(?::\d\d)?(?:\.\d+)?Z?)?(?: UTC)?", "DATE", text)
    text = re.sub(r"dashpot,? (?:version )?\d+\.\d+(?:\.\w+)*", "dashpot VERSION", text)
    text = re.sub(r"\S*dashpot/[\w/]+\.py:\d+", "SOURCE", text)  # where a library warns
    text = re.sub(r"(?<![.\w])(?=[0-9]*[a-f])[0-9a-f]{16,64}\b|\b[0-9a-f]{8}-[0-9a-f-]{27}\b", "HASH", text)
    text = re.sub(r"\bin \d+ iterations?\b", "in N iterations", text)
    return re.sub(r"(?<= )(?:in|took) [\d.]+ s\b", "in TIME", text)


def _file(path: Path) -> Any:
    """A file as text, numbers or arrays; what is only drawn counts as present."""
    match path.suffix:
        case ".json":
            content = json.loads(path.read_text(encoding="utf-8"))
            content.pop("lines", None)  # of an estimate: the data again, and what rounding leaves of them
            return _leaves(content)
        case ".csv":
            return _table(path)
        case ".parquet":
            import pyarrow.parquet as pq

            table = pq.read_table(path)
            return _leaves({name: table[name].to_pylist() for name in table.column_names})
        case ".mat":
            from scipy.io import loadmat

            found = {k: v for k, v in loadmat(path, simplify_cells=True).items() if not k.startswith("__")}
            return _leaves(found)
        case ".fmu":
            with zipfile.ZipFile(path) as archive:
                xml = archive.read("modelDescription.xml").decode()
                return {
                    "names": sorted(archive.namelist()),
                    "xml": re.sub(r'(generationDateAndTime)="[^"]*"', r"\1", xml),
                }
        case ".svg":
            return re.findall(r"<text[^>]*>([^<]*)", path.read_text(encoding="utf-8"))[:200]
        case ".html":
            text = re.sub(
                r"(?s)<(script|style|svg)\b.*?</\1>|<[^>]*>|data:\S+", " ", path.read_text(encoding="utf-8")
            )
            return re.sub(r"\s+", " ", text)
        case ".png" | ".pdf":
            return "drawn"
        case _:
            text = path.read_bytes().decode("utf-8", "replace")
            return text if len(text) < 6000 else {"head": text[:1500], "numbers": _reduced(_numbers_in(text))}


def _table(path: Path) -> Any:
    lines = path.read_text(encoding="utf-8").splitlines()
    head = [line for line in lines if line.startswith("#")]
    names, *rows = csv.reader(lines[len(head) :])
    return {"head": head} | {
        name: _leaves([_cell(cell) for cell in column])
        for name, column in zip(names, zip(*rows, strict=True), strict=False)
    }


def _cell(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text


def _numbers_in(text: str) -> np.ndarray:
    return np.array([float(n.replace("−", "-").replace(",", "")) for n in NUMBER.findall(text)])


def _leaves(value: Any) -> Any:
    """JSON with long arrays reduced and what is no result left out."""
    if isinstance(value, Mapping):
        return {str(k): _leaves(v) for k, v in value.items() if k not in SKIPPED}
    if isinstance(value, np.ndarray | np.generic):
        if np.iscomplexobj(value):
            return {"re": _leaves(np.real(value)), "im": _leaves(np.imag(value))}
        value = value.tolist()
    if isinstance(value, list | tuple):
        flat = _flat(value)
        if flat is None:
            return (
                [_leaves(v) for v in value] if len(value) <= 60 else [*map(_leaves, value[:60]), len(value)]
            )
        return _reduced(np.array(flat)) if len(flat) > LONGEST else _leaf_list(value)
    return float(f"{value:.15g}") if isinstance(value, float) and math.isfinite(value) else _plain(value)


def _leaf_list(value: Any) -> Any:
    return [_leaf_list(v) for v in value] if isinstance(value, list | tuple) else _leaves(value)


def _plain(value: Any) -> Any:
    return value if isinstance(value, str | int | bool | None | float) and value == value else str(value)


def _flat(value: Any) -> list[float] | None:
    """The numbers of nested lists; None where there is something else (null counts as NaN)."""
    if value is None:
        return [math.nan]
    if isinstance(value, int | float) and not isinstance(value, bool):
        return [float(value)]
    if isinstance(value, list | tuple):
        parts = [_flat(v) for v in value]
        return None if any(part is None for part in parts) else [x for part in parts for x in part or ()]
    return None


def _reduced(x: np.ndarray) -> dict[str, Any]:
    """Count, norm, ends and three projections of a long array; NaN are counted and count as zero."""
    gone = ~np.isfinite(x)
    y = np.where(gone, 0.0, x)
    k = np.arange(len(y))
    sums = [float(y @ np.cos(a * k + a * a)) for a in (0.0, 0.7, 2.1)]
    numbers = [float(np.linalg.norm(y)), *sums, *(y[[0, -1]].tolist() if len(y) else [])]
    return {"count": [len(x), int(gone.sum())], "projections": [float(f"{n:.13g}") for n in numbers]}


# ---------------------------------------------------------------- compare


class Tolerance:
    """How far numbers may be apart: `strict` on one machine, otherwise on any."""

    def __init__(self, strict: bool) -> None:
        self.sd = 1e-9 if strict else 1e-4
        self.relative = 1e-7 if strict else 2e-4
        self.absolute = 1e-12 if strict else 1e-9


def differences(old: Result, new: Result, tolerance: Tolerance, *, words: bool = True) -> list[str]:
    """Where two results of one journey are apart: the leaf, the old, the new."""
    found = [f"codes: {old['codes']} → {new['codes']}"] if old["codes"] != new["codes"] else []
    if words:
        found += _text_differences("transcript", old["text"], new["text"])
    found += _differ("files", old["files"], new["files"], tolerance, words, {})
    return found


def _differ(at: str, a: Any, b: Any, t: Tolerance, words: bool, around: Mapping[str, Any]) -> list[str]:
    if isinstance(a, dict) and isinstance(b, dict):
        found = [f"{at}/{k}: {'gone' if k in a else 'new'}" for k in sorted(a.keys() ^ b.keys())]
        for k in a:
            if k in b:
                found += _differ(f"{at}/{k}", a[k], b[k], t, words, a)
        return found
    if isinstance(a, str) and isinstance(b, str):
        return [] if not words and (" " in a or " " in b) else _text_differences(at, a, b)
    if isinstance(a, list) and isinstance(b, list):
        x, y = _flat(a), _flat(b)
        if x is not None and y is not None and len(x) == len(y):
            return _array_differences(at, np.array(x), np.array(y), t, around)
        if len(a) != len(b):
            return [f"{at}: {_short(a)} → {_short(b)}"] if words or not _sentences(a, b) else []
        return [
            line
            for k, (p, q) in enumerate(zip(a, b, strict=False))
            for line in _differ(f"{at}/{k}", p, q, t, words, {})
        ]
    if _is_number(a) and _is_number(b):
        return _array_differences(at, np.array([a]), np.array([b]), t, around)
    return [] if a == b else [f"{at}: {_short(a)} → {_short(b)}"]


def _sentences(*lists: list[Any]) -> bool:
    return all(isinstance(v, str) and " " in v for values in lists for v in values)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _array_differences(
    at: str, x: np.ndarray, y: np.ndarray, t: Tolerance, around: Mapping[str, Any]
) -> list[str]:
    """Numbers beside an `sd` are held to it; others to themselves and, in arrays, to the largest beside them."""
    same = (x == y) | (np.isnan(x) & np.isnan(y))
    finite = np.isfinite(x) & np.isfinite(y)  # what is infinite or missing is the same or it is not
    x, y = np.where(finite, x, np.where(same, 0.0, 1.0)), np.where(finite, y, np.where(same, 0.0, -1.0))
    sd = around.get("sd")
    leaf = at.rsplit("/", 1)[-1]
    allowed = t.relative * np.maximum(abs(x), abs(y)) + t.absolute
    if _is_number(sd) and leaf in ("value", "interval95", "interval"):
        allowed = np.maximum(t.sd * sd, 1e-12 * abs(x))
    elif leaf.endswith("covariance") and (n := math.isqrt(len(x))) ** 2 == len(x):
        deviation = np.sqrt(abs(x.reshape(n, n).diagonal()))
        allowed = t.relative * np.outer(deviation, deviation).ravel() * 2
    elif len(x) > 1:
        allowed = allowed + t.relative * np.max(abs(x[finite]), initial=0.0)
    wrong = (finite & (abs(x - y) > allowed)) | (~finite & ~same)
    if not wrong.any():
        return []
    k = int(np.argmax(wrong))
    return [
        f"{at}[{k}]: {x[k]:.12g} → {y[k]:.12g} (apart by {abs(x[k] - y[k]) / max(allowed[k], 1e-300):.2g} × what is allowed)"  # noqa: E501
    ]


def _text_differences(at: str, a: str, b: str) -> list[str]:
    """Words must be the same, numbers to one and a half of their last digit; where numbers are, so is the layout."""
    if a == b:
        return []
    p, q = _tokens(a), _tokens(b)
    if p == q:  # blanks at the ends of lines are not to be seen
        seen = (re.sub(r" +(?=\n|$)", "", text) for text in (a, b))
        return [f"{at}: laid out otherwise"] if len(set(seen)) > 1 else []
    if len(p) == len(q):
        k = next((k for k, (v, w) in enumerate(zip(p, q, strict=False)) if v != w and not _near(v, w)), None)
        if k is None:
            return []
    else:
        k = next(
            (k for k, (v, w) in enumerate(zip(p, q, strict=False)) if v != w and not _near(v, w)),
            min(len(p), len(q)),
        )
    return [f"{at}: …{' '.join(p[max(k - 4, 0) : k + 6])}… → …{' '.join(q[max(k - 4, 0) : k + 6])}…"]


def _tokens(text: str) -> list[str]:
    return re.sub(r"[─━]{2,}", " ", text).split()


def _near(a: str, b: str) -> bool:
    """Tokens whose words are alike and whose numbers differ by no more than rounding."""
    if NUMBER.sub("#", a) != NUMBER.sub("#", b):
        return False
    return all(abs(float(_ascii(x)) - float(_ascii(y))) <= 1.5 * max(_unit(x), _unit(y)) + 1e-9 * abs(float(_ascii(x)))
               for x, y in zip(NUMBER.findall(a), NUMBER.findall(b), strict=False) if x != y)  # fmt: skip


def _ascii(number: str) -> str:
    return number.replace("−", "-").replace(",", "")


def _unit(number: str) -> float:
    """One unit of the last digit; none of whole numbers, which count something (three digits or fewer)."""
    mantissa, _, exponent = _ascii(number).lower().partition("e")
    digits = len(mantissa.partition(".")[2])
    if not digits and not exponent and len(mantissa.lstrip("+-")) <= 2:
        return 0.0
    return 10.0 ** (int(exponent or 0) - digits)


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 120 else f"{text[:117]}…"


# ---------------------------------------------------------------- the reference and the command


def reference() -> dict[str, Result]:
    """The journeys as recorded."""
    return json.loads(gzip.decompress(REFERENCE.read_bytes())) if REFERENCE.exists() else {}  # type: ignore[no-any-return]


def sample(count: int, seed: int = 0, *, quick: float = math.inf) -> list[str]:
    """Ids of a seeded sample, kinds in turn, of journeys that took at most `quick` seconds when recorded.

    Those that depend on the processor are left out.
    """
    kinds: dict[str, list[str]] = {}
    for id, result in sorted(reference().items()):
        if result["seconds"] <= quick and not result.get("by_processor"):
            kinds.setdefault(re.sub(r"-\d.*", "", id), []).append(id)
    rng = np.random.default_rng(seed)
    rows = [list(rng.permutation(kinds[kind])) for kind in rng.permutation(sorted(kinds))]
    turns = [str(row[k]) for k in range(max(map(len, rows), default=0)) for row in rows if k < len(row)]
    return turns[:count]


def compared(ids: Iterable[str], *, strict: bool = False, words: bool = True) -> dict[str, list[str]]:
    """Ids of journeys that differ from the reference, with their differences."""
    old, journeys, tolerance = reference(), listed.journeys(), Tolerance(strict)
    found = {id: differences(old[id], run(journeys[id]), tolerance, words=words) for id in ids}
    return {id: lines for id, lines in found.items() if lines}


def by_processor(new: Mapping[str, Result], old: Mapping[str, Result], jobs: int) -> set[str]:
    """Journeys that end otherwise where BLAS and the kernel compute as on an older processor.

    What was found so on another machine stays found.
    """
    os.environ.update(dev.older_processor(dev.processor_flags()))
    elsewhere = {id for id in new if old.get(id, {}).get("by_processor")}
    # In other processes than this one, which has loaded its BLAS.
    for id, result in results(sorted(new.keys() - elsewhere), max(jobs, 2)):
        if differences(new[id], result, Tolerance(strict=False)):
            elsewhere.add(id)
    return elsewhere


def _run_by_id(id: str) -> tuple[str, Result]:
    return id, run(listed.journeys()[id])


def results(ids: list[str], jobs: int) -> Iterator[tuple[str, Result]]:
    """Journeys run, in worker processes where there is more than one job."""
    if jobs < 2:
        yield from map(_run_by_id, ids)
        return
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        yield from pool.imap_unordered(_run_by_id, ids, chunksize=2)


def save(kept: Mapping[str, Result]) -> None:
    """The reference, its lines in the order of ids and the file the same for the same content."""
    text = json.dumps(dict(sorted(kept.items())), ensure_ascii=False, separators=(",", ":"))
    REFERENCE.write_bytes(gzip.compress(text.encode(), 9, mtime=0))


def chosen(words: Iterable[str], known: Iterable[str]) -> list[str]:
    """Ids by name or PREFIX*."""
    known = list(known)
    found = []
    for word in words:
        ids = [id for id in known if id == word or (word.endswith("*") and id.startswith(word[:-1]))]
        if not ids:
            raise SystemExit(
                f"no journey {word!r}: PREFIX* chooses several; the first are {', '.join(known[:5])}, …"
            )
        found += ids
    return found


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--sample", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", default=[])
    parser.add_argument("--accept", nargs="+", default=[])
    parser.add_argument("--numbers", action="store_true")
    parser.add_argument("--strict", action="store_true")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    old = reference()
    ids = list(listed.journeys())
    if options.accept or options.only:
        ids = chosen(options.accept or options.only, ids)
    elif options.sample:
        ids = [id for id in sample(options.sample, options.seed) if id in ids]
    new: dict[str, Result] = {}
    for id, result in results(ids, options.jobs):
        new[id] = result
        if bad := {UNMADE, UNCAUGHT} & {*result["codes"]} or result["seconds"] > LONG:
            print(
                f"{id}: {'takes long' if bad is True else bad}, {result['seconds']} s",
                file=sys.stderr,
                flush=True,
            )
    tolerance = Tolerance(options.strict)
    different = 0
    for id in ids:
        lines = (
            ["not recorded"]
            if id not in old
            else differences(old[id], new[id], tolerance, words=not options.numbers)
        )
        if lines and not options.record:
            different += 1
            print(f"{id} ({new[id]['seconds']:.1f} s)", *lines[:4], *["…"] * (len(lines) > 4), sep="\n    ")
    if options.record or options.accept:
        for id in by_processor(new, old, options.jobs):
            new[id]["by_processor"] = True
        save({id: r for id, r in ({} if options.record else old).items() if id in listed.journeys()} | new)
        print(f"{len(new)} recorded, {REFERENCE.stat().st_size / 1e6:.2f} MB")
        return 0
    gone = [] if options.only or options.sample else sorted(old.keys() - set(ids))
    print(
        f"{different} of {len(ids)} journeys differ",
        *(f"recorded but no journey any more: {id}" for id in gone),
        sep="\n",
    )
    return int(bool(different or gone))


if __name__ == "__main__":
    sys.exit(main())
