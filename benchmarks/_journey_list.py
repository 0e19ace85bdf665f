"""The journeys of `journeys.py`: the examples as documented, and seeded random ones over every command.

A journey is a list of steps in a folder of its own: a command (words), or a function that changes files there.
Data come from `dashpot simulate`; what is done to them afterwards (faults, formats) is done here, without dashpot.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs" / "_ext"))

import page_commands  # noqa: E402, of docs/_ext

Step = Sequence[str] | Callable[[], None]
Columns = dict[str, np.ndarray]
METHODS = ("auto", "ls", "hls", "wls", "tls", "cls", "iv", "oiv", "oiv+", "ml")
SECTIONS = ("masses", "springs", "dampers", "inerters", "hysteretic")


@dataclass
class Journey:
    """An id and its steps."""

    id: str
    steps: list[Step] = field(default_factory=list)

    def run(self, *words: str) -> Journey:
        self.steps.append(words)
        return self

    def do(self, change: Callable[..., None], *arguments: Any) -> Journey:
        self.steps.append(lambda: change(*arguments))
        return self

    def write(self, name: str, text: str) -> Journey:
        return self.do(lambda: Path(name).write_text(text, encoding="utf-8") and None)


# ---------------------------------------------------------------- rigs


@dataclass
class Bench:
    """A rig of the journeys: inputs, parts (section, name, keys, true value), channels, band in Hz, drive."""

    name: str
    coordinates: tuple[str, ...]
    inputs: dict[str, dict[str, Any]]
    parts: list[tuple[str, str, dict[str, Any], float]]
    known: frozenset[str]
    band: tuple[float, float]
    drive: str
    angles: tuple[str, ...] = ()
    constants: Mapping[str, float] = field(default_factory=dict)

    @property
    def truth(self) -> dict[str, float]:
        return {name: value for _, name, _, value in self.parts} | dict(self.constants)


def _part(section: str, name: str, value: float, *points: str, **keys: Any) -> Any:
    tie = {"at": points[0]} if len(points) == 1 else {"between": list(points)}
    return section, name, (keys if "along" in keys else tie | keys), value


BASE = {"u": {"kind": "displacement"}}
PUSH = {"f": {"kind": "force", "at": "x1"}}
LINEAR = [
    Bench(
        "one mass on a table", ("x",), BASE,
        [_part("masses", "m", 1.2, "x"), _part("springs", "k", 1900.0, "x", "u"), _part("dampers", "c", 3.0, "x", "u")],
        frozenset({"m"}), (3, 10), "2mm",
    ),
    Bench(
        "two masses on a table", ("x1", "x2"), BASE,
        [
            _part("masses", "m1", 3.0, "x1"), _part("masses", "m2", 2.7, "x2"),
            _part("springs", "k1", 4600.0, "x1", "x2"), _part("springs", "k2", 4600.0, "x2", "u"),
            _part("dampers", "c1", 20.0, "x1", "x2"), _part("dampers", "c2", 30.0, "x2", "u"),
        ],
        frozenset({"k1", "k2"}), (2, 14), "2mm",
    ),
    Bench(
        "two masses pushed", ("x1", "x2"), PUSH,
        [
            _part("masses", "m1", 2.0, "x1"), _part("masses", "m2", 1.0, "x2"),
            _part("springs", "k1", 4000.0, "x1", "ground"), _part("springs", "k2", 2500.0, "x1", "x2"),
            _part("dampers", "c1", 12.0, "x1", "ground"), _part("dampers", "c2", 5.0, "x1", "x2"),
        ],
        frozenset(), (3, 14), "8N",
    ),
    Bench(
        "three storeys", ("x1", "x2", "x3"), BASE,
        [
            *(_part("masses", f"m{k}", 0.5, f"x{k}") for k in (1, 2, 3)),
            *(_part("springs", f"k{k}", 1000.0 - 100 * k, f"x{k}", b) for k, b in zip((1, 2, 3), ("u", "x1", "x2"), strict=False)),  # noqa: E501
            *(_part("dampers", f"c{k}", 0.9 - 0.1 * k, f"x{k}", b) for k, b in zip((1, 2, 3), ("u", "x1", "x2"), strict=False)),  # noqa: E501
        ],
        frozenset({"m1", "m2", "m3"}), (1.5, 13), "1mm",
    ),
    Bench(
        "two discs on a shaft", ("p1", "p2"), {"t": {"kind": "force", "at": "p1"}},
        [
            _part("masses", "j1", 0.02, "p1"), _part("masses", "j2", 0.01, "p2"),
            _part("springs", "s1", 60.0, "p1", "ground"), _part("springs", "s2", 35.0, "p1", "p2"),
            _part("dampers", "d1", 0.05, "p1", "ground"), _part("dampers", "d2", 0.02, "p1", "p2"),
        ],
        frozenset({"j2"}), (3, 15), "0.4", ("p1", "p2"),
    ),
    Bench(
        "an inerter and a hysteretic spring", ("x1", "x2"), BASE | PUSH,
        [
            _part("masses", "m1", 2.0, "x1"), _part("masses", "m2", 1.5, "x2"), _part("inerters", "b", 0.4, "x1", "x2"),
            _part("springs", "k1", 3000.0, "x1", "u"), _part("springs", "k2", 2000.0, "x1", "x2"),
            _part("hysteretic", "h", 150.0, "x1", "u"), _part("dampers", "c2", 6.0, "x1", "x2"),
        ],
        frozenset({"m1"}), (2, 11), "u=2mm",
    ),
    Bench(
        "a lever", ("x", "q"), BASE,
        [
            _part("masses", "m", 4.0, "x"), _part("masses", "j", 0.2, "q"),
            _part("springs", "ka", 2500.0, along={"x": 1, "q": 0.3, "u": -1}),
            _part("springs", "kb", 1800.0, along={"x": 1, "q": -0.25, "u": -1}),
            _part("dampers", "ca", 9.0, along={"x": 1, "q": 0.3, "u": -1}),
            _part("dampers", "cb", 7.0, along={"x": 1, "q": -0.25, "u": -1}),
        ],
        frozenset({"m"}), (1.5, 10), "2mm", ("q",),
    ),
]  # fmt: skip


def _nonlinear(law: str, size: float, section: str = "springs", **constants: float) -> Bench:
    one = LINEAR[0]
    keys = {"law": law} | dict(constants.items())
    parts = [*one.parts, _part(section, "q", size, "x", "u", **keys)]
    return Bench(f"mass with {law}", one.coordinates, one.inputs, parts, one.known, (4, 9), "1mm")


NONLINEAR = [
    _nonlinear("cubic", 2e7),
    _nonlinear("quadratic", 8e4),
    _nonlinear("quadratic", 12.0, "dampers"),
    _nonlinear("coulomb", 0.6, "dampers", v0=0.005),
    _nonlinear("gap", 900.0, gap=0.002),
    _nonlinear("one-sided", 700.0, gap=0.001),
    _nonlinear("jenkins", 500.0, slip=0.002),
]
UNITS = {
    "displacement": ("m", "mm"), "velocity": ("m/s", "mm/s"), "acceleration": ("m/s^2", "g"), "force": ("N", "kN"),
}  # fmt: skip


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(v)}" for key, v in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value) if isinstance(value, (str, bool)) else repr(value)


def channels_of(bench: Bench, rng: np.random.Generator, *, noise: float) -> dict[str, dict[str, Any]]:
    """Every coordinate and input, a motion sensor of random quantity and unit each."""
    channels = {}
    for point in (*bench.coordinates, *bench.inputs):
        if bench.inputs.get(point, {}).get("kind") == "force":
            keys = {"of": point} | ({} if bench.angles else {"unit": str(rng.choice(UNITS["force"]))})
        else:
            is_input = point in bench.inputs
            quantity = (
                "displacement" if is_input else str(rng.choice(["displacement", "velocity", "acceleration"]))
            )
            keys = {"of": point, "quantity": quantity}
            if point not in bench.angles:
                keys["unit"] = str(rng.choice(UNITS[quantity]))
        if point not in bench.inputs:
            keys["relative_noise"] = noise
        channels[point] = keys
    return channels


def rig_text(
    bench: Bench,
    channels: Mapping[str, Mapping[str, Any]],
    *,
    without: Sequence[str] = (),
    values: Mapping[str, dict[str, Any]] | None = None,
    true: bool = False,
) -> str:
    """A rig file; `values` replaces what is known of a part, `true` states every value."""
    lines = [f"name = {_toml(bench.name)}", f"coordinates = {_toml(bench.coordinates)}"]
    lines += [f"angles = {_toml(bench.angles)}"] if bench.angles else []
    lines += ["[inputs]", *(f"{name} = {_toml(keys)}" for name, keys in bench.inputs.items())]
    for section in SECTIONS:
        rows = [part for part in bench.parts if part[0] == section and part[1] not in without]
        lines += [f"[{section}]"] if rows else []
        for _, name, keys, value in rows:
            told = {"value": value} if true or name in bench.known else {}
            told = (values or {}).get(name, told) if not true else told
            lines.append(f"{name} = {_toml(keys | told)}")
    lines += ["[channels]", *(f"{name} = {_toml(dict(keys))}" for name, keys in channels.items())]
    return "\n".join(lines) + "\n"


# ---------------------------------------------------------------- data files, and what goes wrong with them


def read_csv(name: str) -> Columns:
    lines = [line for line in Path(name).read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    columns = zip(*(line.split(",") for line in lines[1:]), strict=True)
    return {name: _column(cells) for name, cells in zip(lines[0].split(","), columns, strict=True)}


def _column(cells: Sequence[str]) -> np.ndarray:
    """Numbers, or words where there is one (how the noise was found, say)."""
    try:
        return np.array([float(cell or "nan") for cell in cells])
    except ValueError:
        return np.array(cells)


def write_csv(name: str, columns: Columns, *, between: str = ",", point: str = ".") -> None:
    rows = [between.join(columns)]
    rows += [
        between.join(v if isinstance(v, str) else f"{v:.10g}".replace(".", point) for v in row)
        for row in zip(*columns.values(), strict=True)
    ]
    Path(name).write_text("\n".join(rows) + "\n", encoding="utf-8")


def changed(change: Callable[[Columns], Columns], name: str = "data.csv", to: str | None = None) -> None:
    write_csv(to or name, change(read_csv(name)))


def of_channel(columns: Columns, name: str) -> list[str]:
    return [c for c in columns if c == name or c.startswith((f"{name}_", f"{name}/"))]


def scaled(name: str, factor: float) -> Callable[[Columns], Columns]:
    def change(columns: Columns) -> Columns:
        return columns | {
            c: columns[c] * (abs(factor) if c.endswith("_sd") else factor) for c in of_channel(columns, name)
        }

    return change


def swapped(a: str, b: str) -> Callable[[Columns], Columns]:
    def change(columns: Columns) -> Columns:
        return columns | {c: columns[b + c[len(a) :]] for c in of_channel(columns, a)} | {
            c: columns[a + c[len(b) :]] for c in of_channel(columns, b)
        }  # fmt: skip

    return change


def conjugated(columns: Columns) -> Columns:
    return {c: -v if c.endswith("_im") else v for c, v in columns.items()}


def late(name: str, tau: float) -> Callable[[Columns], Columns]:
    def change(columns: Columns) -> Columns:
        turn = np.exp(-2j * np.pi * columns["frequency_hz"] * tau)
        z = (columns[f"{name}_re"] + 1j * columns[f"{name}_im"]) * turn
        return columns | {f"{name}_re": z.real, f"{name}_im": z.imag}

    return change


def bad_line(name: str, k: int, factor: float) -> Callable[[Columns], Columns]:
    def change(columns: Columns) -> Columns:
        out = {c: v.copy() for c, v in columns.items()}
        for c in of_channel(out, name):
            out[c][k % len(out[c])] *= factor
        return out

    return change


def mislabelled(k: int) -> Callable[[Columns], Columns]:
    def change(columns: Columns) -> Columns:
        f = columns["frequency_hz"].copy()
        f[k % len(f)] *= 1.17
        return columns | {"frequency_hz": f}

    return change


def without_sd(columns: Columns) -> Columns:
    return {c: v for c, v in columns.items() if not c.endswith("_sd")}


def polar(columns: Columns) -> Columns:
    out = {"frequency_hz": columns["frequency_hz"]}
    for name in [c[:-3] for c in columns if c.endswith("_re")]:
        z = columns[f"{name}_re"] + 1j * columns[f"{name}_im"]
        out |= {f"{name}_amplitude": abs(z), f"{name}_phase": np.degrees(np.angle(z))}
        out |= {f"{name}_sd": columns[f"{name}_sd"]} if f"{name}_sd" in columns else {}
    return out


def frf(reference: str) -> Callable[[Columns], Columns]:
    def change(columns: Columns) -> Columns:
        out = {"frequency_hz": columns["frequency_hz"]}
        r = columns[f"{reference}_re"] + 1j * columns[f"{reference}_im"]
        for name in [c[:-3] for c in columns if c.endswith("_re") and c[:-3] != reference]:
            z = (columns[f"{name}_re"] + 1j * columns[f"{name}_im"]) / r
            out |= {f"{name}/{reference}_re": z.real, f"{name}/{reference}_im": z.imag}
            if f"{name}_sd" in columns:
                out[f"{name}/{reference}_sd"] = columns[f"{name}_sd"] / abs(r)
        return out

    return change


def clipped(name: str, share: float) -> Callable[[Columns], Columns]:
    return lambda columns: (
        columns | {name: np.clip(columns[name], *(share * np.max(columns[name]) * np.array([-1, 1])))}
    )


def held(name: str, start: int, count: int, value: float | None) -> Callable[[Columns], Columns]:
    def change(columns: Columns) -> Columns:
        x = columns[name].copy()
        x[start : start + count] = x[start - 1] if value is None else value
        return columns | {name: x}

    return change


def stepped(name: str, size: float) -> Callable[[Columns], Columns]:
    def change(columns: Columns) -> Columns:
        x = columns[name]
        return columns | {name: x + size * np.std(x) * (np.arange(len(x)) > 0.6 * len(x))}

    return change


def noisy(name: str, size: float, seed: int) -> Callable[[Columns], Columns]:
    def change(columns: Columns) -> Columns:
        x = columns[name]
        return columns | {name: x + size * np.std(x) * np.random.default_rng(seed).standard_normal(len(x))}

    return change


def text_changed(pattern: str, by: str, name: str = "data.csv", count: int = 1) -> None:
    text = Path(name).read_text(encoding="utf-8")
    Path(name).write_text(re.sub(pattern, by, text, count=count), encoding="utf-8")


def drive_record(
    name: str, columns: Sequence[str], kind: str, seed: int, size: float, n: int, rate: float
) -> None:
    """Inputs of a record: noise up to a quarter of the rate, a sweep, a multisine, or a pulse."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) / rate
    out = {"time_s": t}
    for column in columns:
        if kind == "noise":
            Z = np.fft.rfft(rng.standard_normal(n))
            Z[np.fft.rfftfreq(n, 1 / rate) > rate / 6] = 0
            x = np.fft.irfft(Z, n)
        elif kind == "sweep":
            x = np.sin(2 * np.pi * (1.5 * t + 0.5 * 10 / t[-1] * t**2))
        elif kind == "multisine":  # 8 periods in the record
            Z = np.zeros(n // 8 // 2 + 1, dtype=complex)
            upto = max(int(14 * n / 8 / rate), 3)
            Z[1:upto] = np.exp(2j * np.pi * rng.random(upto - 1))
            x = np.tile(np.fft.irfft(Z, n // 8), 8)
        else:
            x = np.where((t > 0.05) & (t < 0.09), np.sin(np.pi * (t - 0.05) / 0.04) ** 2, 0.0)
        out[column] = size * x / np.max(abs(x))
    write_csv(name, out)


def from_time(after: float, drop: Sequence[str]) -> Callable[[Columns], Columns]:
    def change(columns: Columns) -> Columns:
        keep = columns["time_s"] > after
        return {c: v[keep] for c, v in columns.items() if c not in drop}

    return change


def rest_record(name: str, like: str, share: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns = {c: v for c, v in read_csv(like).items() if c != "frequency_hz"}
    n = 800
    step = columns["time_s"][1] - columns["time_s"][0]
    out = {"time_s": np.arange(n) * step}
    out |= {c: share * np.std(v) * rng.standard_normal(n) for c, v in columns.items() if c != "time_s"}
    write_csv(name, out)


def converted(to: str, name: str = "data.csv") -> None:
    """The columns of a CSV file in another format, by SciPy, NumPy, h5py, pyarrow, openpyxl, npTDMS, pyuff."""
    columns = {c: v for c, v in read_csv(name).items() if v.dtype.kind == "f"}
    if to.endswith(".mat"):
        from scipy.io import savemat

        savemat(to, columns)
    elif to.endswith(".npz"):
        np.savez(to, **columns)
    elif to.endswith(".parquet"):
        import pyarrow as pa
        import pyarrow.parquet as pq

        pq.write_table(pa.table(columns), to)
    elif to.endswith(".h5"):
        import h5py

        with h5py.File(to, "w") as file:
            for key, values in columns.items():
                file[key.replace("/", "_over_")] = values
    elif to.endswith(".xlsx"):
        import openpyxl

        book = openpyxl.Workbook()
        for row in [list(columns), *zip(*(v.tolist() for v in columns.values()), strict=True)]:
            book.active.append(list(row))
        book.save(to)
    elif to.endswith(".tdms"):
        from nptdms import ChannelObject, TdmsWriter

        with TdmsWriter(to) as writer:
            writer.write_segment([ChannelObject("run", key, values) for key, values in columns.items()])
    elif to.endswith(".wav"):
        from scipy.io import wavfile

        rate = round(1 / (columns["time_s"][1] - columns["time_s"][0]))
        held = [np.nan_to_num(v) for c, v in columns.items() if c not in ("time_s", "frequency_hz")]
        tracks = [v / np.max(abs(v)) for v in held]  # a gap is silence there
        wavfile.write(to, rate, (np.column_stack(tracks) * 30000).astype(np.int16))
    elif to.endswith(".uff"):
        _write_uff(to, columns)
    elif to.endswith(".txt"):
        write_csv(to, columns, between="\t")
    else:
        write_csv(to, columns, between=";", point=",")


def _write_uff(to: str, columns: Columns) -> None:
    """Time histories, dataset 58 in ASCII, one for each channel."""
    t = columns["time_s"]
    blocks = []
    for node, (name, x) in enumerate(
        ((c, v) for c, v in columns.items() if c not in ("time_s", "frequency_hz")), 1
    ):
        head = [f"{-1:6d}", f"{58:6d}", f"{name:<80}", "NONE", "01-JAN-24 00:00:00", "NONE", "NONE"]
        head.append(f"{1:5d}{0:10d}{0:5d}{0:10d} {name[:10]:<10}{node:10d}{1:4d} {'NONE':<10}{0:10d}{0:4d}")
        head.append(f"{4:10d}{len(x):10d}{1:10d}{t[0]:13.5e}{t[1] - t[0]:13.5e}{0.0:13.5e}")
        head += [f"{q:10d}{0:5d}{0:5d}{0:5d} {label:<20} {unit:<20}" for q, label, unit in
                 ((17, "Time", "s"), (0, name, "NONE"), (0, "NONE", "NONE"), (0, "NONE", "NONE"))]  # fmt: skip
        rows = ["".join(f"{v:20.11e}" for v in x[k : k + 4]) for k in range(0, len(x), 4)]
        blocks += [*head, *rows, f"{-1:6d}"]
    Path(to).write_text("\n".join(blocks) + "\n", encoding="utf-8")


def split_dwells(name: str = "data.csv") -> None:
    """A file for each dwell, its frequency in the name."""
    columns = read_csv(name)
    for f in np.unique(columns["frequency_hz"]):
        rows = columns["frequency_hz"] == f
        write_csv(f"run_{f:g}Hz.csv", {c: v[rows] for c, v in columns.items() if c != "frequency_hz"})


def stacked(names: Sequence[str], to: str) -> None:
    """Tables of several rigs below each other, a column `serial` before."""
    tables = [read_csv(name) for name in names]
    serial = np.repeat(np.arange(len(names)) + 1.0, [len(next(iter(t.values()))) for t in tables])
    write_csv(to, {"serial": serial} | {c: np.concatenate([t[c] for t in tables]) for c in tables[0]})


def modes_file(bench: Bench, name: str = "modes.csv") -> None:
    """Undamped modes of a rig of masses and springs between coordinates and the ground or base, rounded."""
    n = len(bench.coordinates)
    M, K = np.zeros((n, n)), np.zeros((n, n))
    for section, _, keys, value in bench.parts:
        points = [keys["at"]] if "at" in keys else keys["between"]
        b = np.zeros(n)
        for sign, point in zip((1, -1), points, strict=False):
            if point in bench.coordinates:
                b[bench.coordinates.index(point)] = sign
        if section in ("masses", "springs"):
            target = M if section == "masses" else K
            target += value * np.outer(b, b)
    squares, shapes = np.linalg.eig(np.linalg.solve(M, K))
    order = np.argsort(squares)
    rows = {"frequency_hz": np.sqrt(squares[order]) / 2 / np.pi}
    rows["frequency_sd"] = 0.002 * rows["frequency_hz"]
    rows |= {"damping_ratio": 0.02 + 0.01 * np.arange(n), "damping_sd": np.full(n, 0.002)}
    shapes = shapes[:, order] / shapes[0, order]
    for k, point in enumerate(bench.coordinates):
        shape = np.round(shapes[k], 3)
        rows |= {
            f"{point}_re": shape,
            f"{point}_im": 0 * shape,
            f"{point}_sd": np.full(n, 0.01 if k else 0.0),
        }
    write_csv(name, rows)


# ---------------------------------------------------------------- journeys


class Draw:
    """One random journey in the making: its generator, its rig, the data it has written."""

    def __init__(self, id: str, seed: Sequence[int], benches: Sequence[Bench] = LINEAR) -> None:
        self.rng = np.random.default_rng(seed)
        self.bench = benches[int(self.rng.integers(len(benches)))]
        self.noise = float(self.rng.choice([0.005, 0.02, 0.1]))
        self.channels = channels_of(self.bench, self.rng, noise=self.noise)
        self.journey = Journey(id)
        self.seed = int(self.rng.integers(1000))

    def pick(self, *options: Any) -> Any:
        return options[int(self.rng.integers(len(options)))]

    def some(self, *options: tuple[str, ...], share: float = 0.25) -> tuple[str, ...]:
        """Each of the options with the probability `share`."""
        return tuple(word for option in options if self.rng.random() < share for word in option)

    @property
    def motions(self) -> list[str]:
        return [name for name in self.channels if name in self.bench.coordinates]

    @property
    def values(self) -> str:
        return ",".join(f"{k}={v:.10g}" for k, v in self.bench.truth.items() if k not in self.bench.known)

    def rigs(self, *, wrong: bool = False, **more: Any) -> Draw:
        """truth.toml, of which data are made, and rig.toml, which is handed in."""
        told: dict[str, dict[str, Any]] = {}
        truth = self.bench.truth
        free = [name for _, name, _, _ in self.bench.parts if name not in self.bench.known]
        for name in free:
            if self.rng.random() < 0.15:
                told[name] = self.pick(
                    {"value": truth[name] * 1.01, "sd": 0.03 * truth[name]}, {"guess": 1.3 * truth[name]},
                    {"guess": truth[name], "min": 0}, {"value": truth[name]},
                )  # fmt: skip
        if wrong and self.bench.known:
            name = self.pick(*sorted(self.bench.known))
            told[name] = {"value": truth[name] * self.pick(0.6, 1.15, 2.0, -1.0)}
        self.journey.write("truth.toml", rig_text(self.bench, self.channels, true=True))
        self.journey.write(
            "rig.toml", rig_text(self.bench, more.pop("channels", self.channels), values=told, **more)
        )
        return self

    def frequencies(self, lines: int) -> str:
        low, high = self.bench.band
        return f"{low}:{high}/{lines}{self.pick('', 'log')}"

    def table(self, out: str = "data.csv", lines: int | None = None, seed: int | None = None) -> Draw:
        lines = lines or int(self.rng.integers(12, 40))
        self.journey.run(
            "simulate", "truth.toml", "--frequencies", self.frequencies(lines), "--amplitude", self.bench.drive,
            "--table", "-o", out, "--seed", str(self.seed if seed is None else seed),
        )  # fmt: skip
        return self

    def dwells(self, out: str = "data.csv", lines: int | None = None) -> Draw:
        low, high = self.bench.band
        lines = lines or int(self.rng.integers(8, 16))
        self.journey.run(
            "simulate", "truth.toml", "--frequencies", ",".join(f"{f:.2f}" for f in np.linspace(low, high, lines)),
            "--amplitude", self.bench.drive, "--samples", str(self.pick(60, 128, 200)), "--periods",
            str(self.pick(4, 8, 10)), "-o", out, "--seed", str(self.seed),
        )  # fmt: skip
        return self

    def record(
        self, kind: str, out: str = "data.csv", n: int = 1600, rate: float = 100.0, seed: int = 0
    ) -> Draw:
        size = 5.0 if all(i["kind"] == "force" for i in self.bench.inputs.values()) else 0.003
        size *= 0.1 if self.bench.angles and size == 5.0 else 1
        plain = {name: {"of": name} for name in self.bench.inputs}
        shown = {name: {k: v for k, v in keys.items() if k != "unit"} for name, keys in self.channels.items()}
        self.channels = {name: plain.get(name, keys) for name, keys in shown.items()}
        self.rigs()
        self.journey.do(
            drive_record, "drive.csv", list(self.bench.inputs), kind, self.seed + seed, size, n, rate
        )
        self.journey.run(
            "simulate", "truth.toml", "--input", "drive.csv", "-o", out, "--seed", str(self.seed + seed)
        )
        return self

    def settings(self) -> tuple[str, ...]:
        """Options of time records."""
        return self.some(
            ("--orders", self.pick("auto", "1")), ("--harmonics", self.pick("none", "2,3")),
            ("--drift", self.pick("none", "0", "1", "2")), ("--noise", self.pick("own", "white", "blocks")),
            ("--refine", self.pick("always", "none")), ("--settle", self.pick("auto", "0.2s")),
            ("--transients", self.pick("estimate", "none", "settle")), share=0.2,
        )  # fmt: skip

    def fault_of_table(self) -> Callable[[Columns], Columns]:
        motion, other = self.pick(*self.motions), self.pick(*self.channels)
        _low, high = self.bench.band
        return self.pick(
            scaled(motion, -1), scaled(motion, 1000.0), scaled(other, 1.15), scaled(motion, 9.80665), conjugated,
            late(motion, 0.05 / high), bad_line(motion, self.seed, 1.4), bad_line(other, self.seed, -1),
            mislabelled(self.seed), swapped(motion, other), scaled(motion, 0.0),
            lambda columns: columns | {"frequency_hz": 2 * np.pi * columns["frequency_hz"]},
        )  # fmt: skip

    def fault_of_samples(self) -> Callable[[Columns], Columns]:
        motion = self.pick(*self.motions)
        return self.pick(
            clipped(motion, 0.5), held(motion, 150, 12, None), held(motion, 210, 9, 0.0), stepped(motion, 1.0),
            noisy(motion, 0.3, self.seed), held(motion, 170, 1, 1e3), scaled(motion, -1), scaled(motion, 0.0),
            held(self.pick(*self.channels), 100, 3, float("nan")),
        )  # fmt: skip

    def identify(self, *data: str, rig: str = "rig.toml", settings: Sequence[str] = ()) -> Journey:
        words = self.some(("--matrices",), ("--level", "90%"), ("--strict",), share=0.15)
        words += self.some(
            ("--apply", "new.toml"), ("--report", "report.html", "--label", "A test"), share=0.08
        )
        method = self.pick(*METHODS)
        words += ("--method", method) if self.rng.random() < 0.5 else self.some(("--positive",), share=0.1)
        return self.journey.run(
            "identify", rig, *(data or ("data.csv",)), "--json", "estimate.json", *words, *settings
        )


def examples() -> Iterator[Journey]:
    """What the READMEs of the examples print, in a copy of each folder; commands that take long stand alone."""
    for page in sorted((ROOT / "examples").glob("*/README.md")):
        journey = Journey(f"example-{page.parent.name}").do(
            lambda folder=page.parent: shutil.copytree(folder, ".", dirs_exist_ok=True) and None
        )
        for block in re.findall(
            r"^```sh\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
        ):
            for line in page_commands.lines(block):
                words = line.split("#")[0].strip()
                if words.startswith("dashpot identify") and "--json" not in words:
                    words += f" --json estimate{len(journey.steps)}.json"
                journey.run("line", words)
        if len(journey.steps) > 1:
            yield journey


def identify_tables(k: int, d: Draw) -> Journey:
    d.rigs(wrong=k % 5 == 4, without=[d.bench.parts[-1][1]] if k % 7 == 6 else []).table()
    if k % 3 == 1:
        d.journey.do(changed, d.fault_of_table())
    if k % 4 == 3:
        d.journey.do(changed, without_sd)
    form = d.pick(None, None, polar, frf(next(iter(d.bench.inputs))), scaled(d.motions[0], 1.0))
    if form:
        d.journey.do(changed, form)
    return d.identify()


def identify_calibrations(k: int, d: Draw) -> Journey:
    """Channels with unknown gain, delay or sign, a coordinate that is not seen, or two tests in one fit."""
    channels = {name: dict(keys) for name, keys in d.channels.items()}
    name = d.motions[-1]
    if k % 4 == 0 and len(d.motions) > 1:
        del channels[name]
    else:
        channels[name] |= [{"gain": "unknown"}, {"sign": "unknown"}, {"delay": "unknown"}, {"gain": 2.0}][
            k % 4
        ]
    d.rigs(channels=channels).table().table("second.csv", seed=d.seed + 1)
    return d.identify("data.csv", "second.csv") if k % 2 else d.identify()


FORMATS = ("d.mat", "d.npz", "d.parquet", "d.h5", "d.xlsx", "d.tdms", "d.txt", "semicolon.csv")


def identify_dwells(k: int, d: Draw) -> Journey:
    d.rigs(wrong=k % 6 == 5).dwells()
    if k % 3 == 1:
        d.journey.do(changed, d.fault_of_samples())
    settings = d.settings()
    if k % 8 == 7:
        d.journey.do(rest_record, "still.csv", "data.csv", 0.02, d.seed)
        settings += ("--noise-record", "still.csv")
    if k % 2 == 0:
        to = FORMATS[k // 2 % len(FORMATS)]
        return d.journey.do(converted, to) and d.identify(to, settings=settings)
    return d.identify(settings=settings)


def identify_files(k: int, d: Draw) -> Journey:
    """A file for each dwell: a pattern, a manifest, parts."""
    d.rigs().dwells().journey.do(split_dwells)
    if k % 3 == 0:
        return d.identify("run_{frequency}Hz.csv", settings=d.settings())
    if k % 3 == 1:
        d.journey.write(
            "test.toml", '[conditioning]\nrefine = "always"\n[[files]]\nname = "run_{frequency}Hz.csv"\n'
        )
        return d.identify("test.toml")
    return d.journey.run(
        "identify", "rig.toml", "data.csv", "data.csv", "--in-parts", "--workers", "1", "--json", "e.json"
    )


def identify_records(k: int, d: Draw) -> Journey:
    kind = ("noise", "sweep", "noise", "pulse")[k % 4]
    d.record(kind, n=d.pick(800, 1600))
    low, high = d.bench.band
    settings = d.some(("--band", f"{0.5 * low:g}:{1.3 * high:g}"), ("--hold-out", "25%"), share=0.4)
    if k % 3 == 1:
        d.journey.do(changed, d.fault_of_samples())
    if k % 3 == 2:
        d.journey.do(rest_record, "still.csv", "data.csv", d.noise, d.seed)
        settings += ("--noise-record", "still.csv")
    to = ("data.csv", "d.uff", "d.mat", "d.wav", "d.parquet")[k % 5]
    if to != "data.csv":
        d.journey.do(converted, to)
    return d.journey.run("identify", "rig.toml", to, "--json", "estimate.json", *settings)


def identify_multisines(k: int, d: Draw) -> Journey:
    d.record("multisine", n=1600)
    d.journey.write(
        "test.toml",
        f'[[files]]\nname = "data.csv"\nfrequency_hz = 0.5\nlines = "{d.pick("3:26", "4:26:2")}"\nskip_periods = 2\n',
    )
    return d.identify("test.toml")


def identify_decays(k: int, d: Draw) -> Journey:
    d.record("pulse", n=900)
    d.journey.do(changed, from_time(0.1, list(d.bench.inputs)))
    forces = [name for name, keys in d.bench.inputs.items() if keys["kind"] == "force"]
    for name in d.bench.inputs:
        if name in forces:
            d.journey.do(text_changed, rf"\n{name} = .*", "", "rig.toml", 2)
            d.journey.do(text_changed, r"\[inputs\]", "", "rig.toml")
        else:
            d.journey.do(text_changed, f'"{name}"', '"ground"', "rig.toml", 9)
            d.journey.do(text_changed, rf"\n{name} = .*", "", "rig.toml", 2)
    return d.journey.run("identify", "rig.toml", "data.csv", "--json", "estimate.json")


def identify_nonlinear(k: int, d: Draw) -> Journey:
    """Dwells at two levels or one, the law known, or a linear rig beside them."""
    linear = k % 3 == 0
    d.rigs(without=["q"] if linear else []).dwells(lines=9)
    return d.journey.run(
        "identify", "rig.toml", "data.csv", "--json", "e.json", *(("--orders", "1,3") if k % 2 else ())
    )


def identify_nonlinear_records(k: int, d: Draw) -> Journey:
    d.record(d.pick("noise", "sweep"), n=500)
    if k % 3 == 0:
        d.rigs(without=["q"])
    return d.journey.run("identify", "rig.toml", "data.csv", "--json", "e.json")


def identify_modes(k: int, d: Draw) -> Journey:
    d.bench = LINEAR[2:4][k % 2]
    d.channels = channels_of(d.bench, d.rng, noise=0.02)
    d.rigs().journey.do(modes_file, d.bench)
    if k % 3 == 1:
        return d.table().journey.run(
            "compare", "rig.toml", "data.csv", "--modal", "modes.csv", "--json", "c.json"
        )
    return d.journey.run("identify", "rig.toml", "modes.csv", "--json", "e.json", *d.some(("--positive",)))


def damaged(k: int, d: Draw) -> Journey:
    """Files and options that are wrong."""
    d.rigs()
    if k % 2:
        d.table()
    else:
        d.dwells(lines=8)
    name = d.motions[0]
    options: tuple[str, ...] = ()
    faults: list[Any] = [
        lambda: text_changed(r"(?<=\n)\d[^,\n]*,", "about,"), lambda: text_changed(r"frequency_hz", "frequency"),
        lambda: text_changed(rf"\b{name}", "other", count=3), lambda: Path("data.csv").write_text("") and None,
        lambda: Path("data.csv").write_bytes(bytes(range(256)) * 20) and None, lambda: Path("data.csv").unlink(),
        lambda: text_changed(r",[^,\n]*(?=\n)", "", count=5), lambda: text_changed(r"(?<=\n)[^,\n]*,", "nan,"),
        lambda: text_changed(r"between", "betwen", "rig.toml"), lambda: text_changed(r"\]", "", "rig.toml"),
        lambda: text_changed(r"kind = \"\w+\"", 'kind = "heat"', "rig.toml"), lambda: text_changed(r"masses", "mass", "rig.toml"),  # noqa: E501
        lambda: text_changed(r'"(x1?|p1)"', '"y9"', "rig.toml", 2), lambda: text_changed(r"unit = ", "units = ", "rig.toml"),  # noqa: E501
        lambda: text_changed(r"value = ", "value = -", "rig.toml", 3), lambda: text_changed(r"coordinates", "cordinates", "rig.toml"),  # noqa: E501
    ]  # fmt: skip
    wrong: list[tuple[str, ...]] = [
        ("--method", "best"), ("--level", "2"), ("--band", "4:1"), ("--noise", "pink"), ("--json", "no/such/e.json"),
        ("--workers", "2"), ("--label", "x"), ("--settle", "-1s"), ("--orders", "1,x"), ("--frequency", "zero"),
        ("--report", "r.docx"), ("--hold-out", "25%"), ("--modal-sd", "1%"), ("--nonsense",), ("--drift", "9"),
        ("--noise-record", "none.csv"),
    ]  # fmt: skip
    if k % 3 == 0:
        options = wrong[k // 3 % len(wrong)]
    else:
        d.journey.do(faults[k % len(faults)])
    return d.journey.run(d.pick("identify", "identify", "compare", "check"), "rig.toml", "data.csv", *options)


def compare(k: int, d: Draw) -> Journey:
    if k % 4 == 3:
        d.bench = NONLINEAR[k % len(NONLINEAR)]
        d.channels = channels_of(d.bench, d.rng, noise=0.01)
        d.rigs(without=["q"]).dwells(lines=9)
        return d.journey.run("compare", "rig.toml", "data.csv", "--elements", "--json", "c.json")
    d.rigs()
    if k % 2:
        d.table()
    else:
        d.dwells()
    words = d.some(("--methods", "wls,oiv,ml"), ("--truth", d.values), ("--level", "99%"), share=0.5)
    return d.journey.run("compare", "rig.toml", "data.csv", "--json", "c.json", *words)


def check(k: int, d: Draw) -> Journey:
    d.rigs(wrong=k % 4 == 3, without=[d.bench.parts[-1][1]] if k % 5 == 4 else [])
    if k % 6 == 5:
        d.journey.do(text_changed, rf"\n{d.motions[0]} = .*", "", "rig.toml")
    if k % 3 == 0:
        return d.journey.run("check", "rig.toml", "--json", "c.json")
    d.table() if k % 3 == 1 else d.dwells()
    free = [p[1] for p in d.bench.parts if p[1] not in d.bench.known]
    words = d.some(("--known",), ("--profile", d.pick(*free)), ("--level", "68%"), share=0.4)
    return d.journey.run("check", "rig.toml", "data.csv", "--json", "c.json", *words)


def simulate(k: int, d: Draw) -> Journey:
    if k % 3 == 2:
        return d.record(d.pick("noise", "sweep", "pulse"), n=200).journey
    d.rigs()
    d.table() if k % 3 == 0 else d.dwells(lines=4)
    extra = d.some(("--relative-noise", "5%"), ("--rate", "300"), ("--set", "nothing=1"), share=0.3)
    return d.journey.run(
        "simulate", "rig.toml", "--set", d.values, "--frequencies", "2,5", "-o", "more.csv", *extra
    )


def validate(k: int, d: Draw) -> Journey:
    if k % 2:
        d.record("noise", n=1000)
        d.journey.run("identify", "rig.toml", "data.csv", "--json", "estimate.json")
        d.record("sweep", out="other.csv", n=600, seed=3)
    else:
        d.rigs().dwells()
        d.journey.run("identify", "rig.toml", "data.csv", "--json", "estimate.json")
        d.table("other.csv", seed=d.seed + 5)
    if k % 3 == 2:
        d.journey.do(changed, scaled(d.motions[0], 1.2), "other.csv")
    source = "rig.toml" if k % 7 == 6 else "estimate.json"
    return d.journey.run("validate", source, "other.csv", "--json", "v.json", *d.some(("--rig", "rig.toml")))


def draw(k: int, d: Draw) -> Journey:
    d.rigs()
    if k % 3 == 0:
        return d.journey.run("draw", "rig.toml", "-o", "rig.svg")
    if k % 3 == 1:
        return d.journey.run("draw", "truth.toml", "--mode", str(d.pick(1, 2, 7)), "-o", "mode.svg")
    d.table().journey.run("identify", "rig.toml", "data.csv", "-q", "--json", "e.json")
    return d.journey.run(
        "draw", "rig.toml", "--estimate", "e.json", "-o", "rig.svg", *d.some(("--mode", "1"), share=0.5)
    )


def export(k: int, d: Draw) -> Journey:
    d.rigs()
    source = ("truth.toml", "rig.toml", "e.json")[k % 3]
    if source == "e.json":
        d.table().journey.run("identify", "rig.toml", "data.csv", "-q", "--json", "e.json")
    frequencies = ("--frequencies", d.frequencies(9))
    words: tuple[str, ...] = (
        ("s.mat",), ("s.json",), ("r.fmu", "--no-binary"), ("m.uff", *frequencies), ("m.mtx",), ("m.xml",), ("p.csv",),
        ("p.parquet",), ("p.m",), ("f.csv", "--to", "frequency-responses", *frequencies),
        ("t.json", "--to", "transfer-functions"), ("s.json", "--to", "state-space", "--input-quantity", "acceleration"),
        ("x.doc",), ("r.fmu", "--no-binary", "--input-quantity", "velocity"), ("p.mat", "--to", "parameters"),
    )[k % 15]  # fmt: skip
    values = ("--set", d.values) if source == "rig.toml" else ()
    return d.journey.run("export", source, "-o", *words, *values)


def response(k: int, d: Draw) -> Journey:
    d.rigs()
    low, high = d.bench.band
    words = ("--at", f"{0.5 * (low + high):g}") if k % 4 == 3 else ("--band", f"{low:g}:{high:g}")
    more = d.some(("--backbone", "1"), ("--amplitude", "0.3mm"), share=0.4)
    return d.journey.run(
        "response", "truth.toml", *words, "--amplitude", d.bench.drive, *more, "-o", "curves.csv"
    )


def new(k: int, d: Draw) -> Journey:
    words = ("--name", "Mine", "--masses", str(d.pick(1, 2, 4, 0)), "--driven-by", d.pick("base", "force"))
    motion = d.pick("displacement", "velocity", "acceleration")
    words += (
        "--motion",
        motion,
        "--unit",
        d.pick(*UNITS[motion], "m"),
        "--first-mass",
        d.pick("1.25kg", "2", "-1"),
    )
    return d.journey.run("new", "rig.toml", *words).run("check", "rig.toml")


def inspect(k: int, d: Draw) -> Journey:
    if k % 3 == 0:
        d.rigs().table()
    elif k % 3 == 1:
        d.rigs().dwells(lines=6).journey.do(changed, d.fault_of_samples())
    else:
        d.record(d.pick("noise", "pulse"), n=400)
        if k % 2:
            d.journey.do(changed, d.fault_of_samples())
    name = "data.csv"
    if k % 2:
        formats = (*FORMATS, "d.wav", "d.uff") if k % 3 == 2 else FORMATS
        name = formats[k // 2 % len(formats)]
        d.journey.do(converted, name)
    return d.journey.run("inspect", name, *d.some(("--channels", "channels.toml"), share=0.5))


def spectrum(k: int, d: Draw) -> Journey:
    d.rigs().dwells(lines=7)
    if k % 3 == 1:
        d.journey.do(changed, d.fault_of_samples())
    return d.journey.run("spectrum", "rig.toml", "data.csv", "-o", "amplitudes.csv", *d.settings())


def frequency_responses(k: int, d: Draw) -> Journey:
    d.rigs().dwells(lines=7)
    return d.journey.run("frf", "data.csv", "--rig", "rig.toml", "--json", "f.json", "-o", "f.csv")


def start(k: int, d: Draw) -> Journey:
    d.record("noise", n=400) if k == 1 else d.rigs().dwells(lines=6)
    return d.journey.run("start", "data.csv", "--out", "first.toml").run("check", "first.toml")


def measured_modes(k: int, d: Draw) -> Journey:
    d.rigs().dwells(lines=24)
    return d.journey.run("modes", "data.csv", "--rig", "rig.toml", "--json", "m.json", "-o", "m.csv")


def track(k: int, d: Draw) -> Journey:
    d.record("noise", n=3200)
    return d.journey.run(
        "track", "rig.toml", "data.csv", "--window", "8s", "--json", "t.json", "-o", "t.parquet"
    )


def fleet(k: int, d: Draw) -> Journey:
    d.rigs()
    names = [f"rig{i}.csv" for i in range(5)]
    for i, name in enumerate(names):
        d.table(name, lines=14, seed=i)
    if k % 2:
        d.journey.do(changed, scaled(d.motions[0], 1.5), names[2])
    if k % 3 == 0:
        d.journey.do(stacked, names, "all.csv")
        data = ("all.csv", "--rig-column", "serial")
    else:
        data = ("rig*.csv",)
    words = d.some(("--pool",), ("--method", "ml"), ("--positive",), ("--order", "given"), share=0.35)
    return d.journey.run(
        "fleet", "rig.toml", *data, "-o", "f.parquet", "--json", "f.json", "--workers", "1", *words
    )


def study(k: int, d: Draw) -> Journey:
    d.rigs()
    text = f"""name = "noise"
seed = {d.seed}
[rigs.one]
file = "truth.toml"
values = {{}}
[frequencies]
few = {np.round(np.linspace(*d.bench.band, 8), 2).tolist()}
[[grid]]
methods = ["{d.pick("ls", "wls", "iv")}", "oiv", "ml"]
noise = [0.01, 0.1]
samples = 20
draws = 4
"""
    values = (
        "{ " + ", ".join(f"{n} = {v!r}" for n, v in d.bench.truth.items() if n not in d.bench.known) + " }"
    )
    text = text.replace("truth.toml", "rig.toml").replace("{}", values)
    if k % 5 == 4:
        text = text.replace("grid", "grit")
    return d.journey.write("study.toml", text).run("study", "study.toml", "--out", "out", "--workers", "1")


def design(k: int, d: Draw) -> Journey:
    d.rigs()
    low, high = d.bench.band
    size = (("--samples", "700"), ("--time", "3min", "--rate", "200"), ("--target", "2%", "--rate", "200"))[
        k % 3
    ]
    free = [p[1] for p in d.bench.parts if p[1] not in d.bench.known]
    words = d.some(
        ("--for", d.pick("worst", "volume", free[0])), ("--max-frequencies", "5"), ("--grid", "0.25"),
        ("--settling-time", d.pick("none", "2s")), ("--against", d.frequencies(6)), ("--min-dwell", "5s"),
        ("--csv", "plan.csv"), ("--sensors", f"pick 1 of {','.join(d.motions)}"), ("--max-force", "30N"), share=0.2,
    )  # fmt: skip
    if k % 4 == 3:
        d.table()
        words += ("--after", "data.csv")
    if k % 8 == 2 and len(free) <= 2:
        words += ("--doubt", "20%")
    return d.journey.run(
        "design", "rig.toml", *size, "--set", d.values, "--band", f"{low}:{high}", "--amplitude", d.bench.drive,
        "--json", "plan.json", *words,
    )  # fmt: skip


def helps() -> Iterator[Journey]:
    commands = [
        "identify",
        "validate",
        "compare",
        "check",
        "simulate",
        "draw",
        "export",
        "response",
        "new",
        "inspect",
        "spectrum",
        "fleet",
        "study",
        "design",
        "reproduce",
        "completion",
        "start",
        "frf",
        "modes",
        "track",
    ]
    yield Journey("help").run("--help").run("--version").run("nonsense").run()
    yield from (Journey(f"help-{command}").run(command, "--help").run(command) for command in commands)
    yield Journey("help-serve").run("serve", "--help").run("serve", "nowhere")
    yield from (Journey(f"completion-{shell}").run("completion", shell) for shell in ("bash", "zsh", "fish"))
    yield Journey("reproduce").run("reproduce", "yamane1989", "--draws", "3", "--workers", "1")


KINDS: tuple[tuple[str, Callable[[int, Draw], Journey], int, Sequence[Bench]], ...] = (
    ("identify-table", identify_tables, 40, LINEAR), ("identify-calibration", identify_calibrations, 12, LINEAR),
    ("identify-dwells", identify_dwells, 32, LINEAR), ("identify-files", identify_files, 6, LINEAR),
    ("identify-record", identify_records, 20, LINEAR[:5]), ("identify-multisine", identify_multisines, 6, LINEAR[:5]),
    ("identify-decay", identify_decays, 6, LINEAR[:4]), ("identify-nonlinear", identify_nonlinear, 14, NONLINEAR),
    ("identify-nonlinear-record", identify_nonlinear_records, 8, NONLINEAR[:4]), ("identify-modes", identify_modes, 6, LINEAR),  # noqa: E501
    ("damaged", damaged, 48, LINEAR), ("compare", compare, 12, LINEAR), ("check", check, 18, LINEAR),
    ("simulate", simulate, 9, LINEAR + NONLINEAR), ("validate", validate, 10, LINEAR[:4]), ("draw", draw, 9, LINEAR),
    ("export", export, 30, LINEAR), ("response", response, 8, NONLINEAR), ("new", new, 6, LINEAR),
    ("inspect", inspect, 20, LINEAR), ("spectrum", spectrum, 9, LINEAR), ("fleet", fleet, 8, LINEAR[:4]),
    ("study", study, 5, LINEAR[:3]), ("design", design, 16, LINEAR),
    ("frf", frequency_responses, 3, LINEAR), ("modes", measured_modes, 3, LINEAR), ("start", start, 3, LINEAR),
    ("track", track, 2, LINEAR[:4]),
)  # fmt: skip


def journeys() -> dict[str, Journey]:
    """All of them by id.  A kind's k-th journey is drawn from a seed of its own, so that adding one changes no other."""  # noqa: E501
    found = [*examples(), *helps()]
    for place, (kind, make, count, benches) in enumerate(KINDS):
        for k in range(count):
            found.append(make(k, Draw(f"{kind}-{k:02d}", (1989, place, k), benches)))
    return {journey.id: journey for journey in found}
