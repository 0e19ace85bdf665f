"""Modes of the same records by dashpot, pyOMA-2 and sdypy-EMA: error, intervals, time, and what was chosen by hand.

`python3 dev.py bench modes [--draws N] [--alone N] [--case NAME]`.  Systems of known modes
(`tests/unit/free/bench.py`) under one random force up to 35 Hz, 100 s at 100 samples a second, 2 % noise on three
accelerometers.

- dashpot gets the record and the name of the input; order, band and poles it finds.
- pyOMA-2 gets the record: stochastic subspace identification of the outputs (`cov`, its default of 20 block rows), and
  with the force (`IOcov`, 60 block rows); and the true frequencies, near which a user would pick poles.
- sdypy-EMA gets frequency responses (H1, Hann windows of 20 or 50 s with half overlap), a band, an order of 60, and
  the true frequencies, near which it picks poles, or we do, at the highest order.

`--alone N`: N more draws by dashpot alone, for the coverage of its intervals.  The peers are not among dashpot's
requirements: `pip install pyOMA-2 sdypy-EMA`; those that are missing are left out, and said to be.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import logging
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from scipy import signal

import dashpot
from dashpot.data.record import Record
from tests.unit.free.bench import RATE, Bench

SECONDS = 100.0
NOISE = 0.02
CASES = {
    "two modes": Bench((4.0, 9.0), (0.01, 0.02), 3),
    "a pair 2 % apart": Bench((4.0, 4.08, 9.0), (0.005, 0.005, 0.02), 3),
    "damping 0.1 to 10 %": Bench((3.0, 7.0, 12.0), (0.001, 0.1, 0.01), 3),
}
NEAR = 0.01  # of a frequency: a mode within it is found


@dataclass(frozen=True)
class Found:
    """Frequencies, damping ratios and shapes (modes, points), standard deviations where there are some."""

    frequency_hz: np.ndarray
    damping: np.ndarray
    shapes: np.ndarray
    frequency_sd: np.ndarray | None = None
    damping_sd: np.ndarray | None = None
    shape_sd: np.ndarray | None = None


def by_dashpot(record: Record, bench: Bench) -> Found:
    found = dashpot.modes(record, "u0")
    return Found(
        found.frequency_hz,
        found.damping_ratio,
        found.shapes,
        found.frequency_sd,
        found.damping_sd,
        found.shape_sd,
    )


def by_pyoma(method: str, rows: int) -> Callable[[Record, Bench], Found]:
    def identified(record: Record, bench: Bench) -> Found:
        from pyoma2.algorithms import SSI
        from pyoma2.setup import SingleSetup

        setup = SingleSetup(np.array(record.values[:, 1:]), RATE)
        inputs = {"U": np.array(record.values[:, :1])} if method == "IOcov" else {}
        algorithm = SSI(name="ssi", method=method, br=rows, ordmax=40, **inputs)
        setup.add_algorithms(algorithm)
        setup.run_by_name("ssi")
        setup.mpe("ssi", sel_freq=list(bench.frequency_hz), order_in="find_min")
        result = setup["ssi"].result
        return Found(np.array(result.Fn), np.array(result.Xi), np.array(result.Phi).T)

    return identified


def by_sdypy(record: Record, bench: Bench, window: float, at_highest: bool) -> Found:
    from sdypy import EMA

    settings = {"fs": RATE, "window": "hann", "nperseg": round(window * RATE)}
    force, outputs = record.values[:, 0], record.values[:, 1:].T
    hz, cross = signal.csd(force[None], outputs, **settings)
    _, power = signal.welch(force, **settings)
    model = EMA.Model(cross / power, hz, lower=1.0, upper=20.0, pol_order_high=60, frf_form="accelerance")
    model.get_poles(show_progress=False)
    if at_highest:  # as one picks them by hand in the stabilisation chart
        hz_of, damping = np.array(model.pole_freq[-1]), np.array(model.pole_xi[-1])
        picked = [
            int(np.argmin(np.where(damping > 0, np.abs(hz_of - f), np.inf))) for f in bench.frequency_hz
        ]
        model.pole_ind = [[len(model.all_poles) - 1, pole] for pole in picked]
        frequency_hz, ratios = hz_of[picked], damping[picked]
    else:
        model.select_closest_poles(list(bench.frequency_hz), f_window=1)
        frequency_hz, ratios = np.array(model.nat_freq), np.array(model.nat_xi)
    _, constants = model.get_constants()
    return Found(frequency_hz, ratios, np.array(constants).T)


TOOLS: dict[str, tuple[str | None, Callable[[Record, Bench], Found]]] = {
    "dashpot": (None, by_dashpot),
    "pyOMA-2, outputs alone, default": ("pyoma2", by_pyoma("cov", 20)),
    "pyOMA-2, force and outputs": ("pyoma2", by_pyoma("IOcov", 60)),
    "sdypy-EMA, 20 s, its choice": ("sdypy.EMA", partial(by_sdypy, window=20.0, at_highest=False)),
    "sdypy-EMA, 50 s, order 60": ("sdypy.EMA", partial(by_sdypy, window=50.0, at_highest=True)),
}


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Without what tools print."""
    with (
        warnings.catch_warnings(),
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()),
    ):
        warnings.simplefilter("ignore")
        yield


@cache
def record_of(bench: Bench, seed: int) -> Record:
    """The record of one draw."""
    rng = np.random.default_rng(seed)
    return bench.record(bench.noise(rng, SECONDS, 1), rng, NOISE)


def true_shapes(bench: Bench) -> np.ndarray:
    """(modes, points), the largest entry 1."""
    shapes = bench.shapes[: bench.points].T
    largest = np.argmax(np.abs(shapes), axis=1)
    return shapes / shapes[np.arange(len(shapes)), largest][:, None]


def errors(found: Found, bench: Bench) -> dict[str, np.ndarray] | None:
    """Relative errors of frequencies and damping ratios, 1 − MAC, errors over standard deviations; None: not found."""
    true = np.array(bench.frequency_hz)
    if not len(found.frequency_hz) or not np.all(np.isfinite(found.frequency_hz)):
        return None
    nearest = [int(np.argmin(np.abs(found.frequency_hz - f))) for f in true]
    f, zeta = found.frequency_hz[nearest], found.damping[nearest]
    if len(set(nearest)) < len(true) or np.any(np.abs(f / true - 1) > NEAR):
        return None
    shapes, wanted = found.shapes[nearest], true_shapes(bench)
    product = np.abs(np.sum(np.conj(shapes) * wanted, axis=1)) ** 2
    mac = product / np.sum(np.abs(shapes) ** 2, axis=1) / np.sum(wanted**2, axis=1)
    each = {"frequency": f / true - 1, "damping": zeta / np.array(bench.damping) - 1, "1 - MAC": 1 - mac}
    if found.frequency_sd is not None and found.damping_sd is not None and found.shape_sd is not None:
        each["z of frequency"] = (f - true) / found.frequency_sd[nearest]
        each["z of damping"] = (zeta - np.array(bench.damping)) / found.damping_sd[nearest]
        sd = found.shape_sd[nearest]
        some = sd > 0
        each["z of shapes"] = np.concatenate([((shapes - wanted).real / np.where(some, sd, 1))[some]])
        each["z of shapes"] = np.append(each["z of shapes"], (shapes.imag / np.where(some, sd, 1))[some])
    return each


def run(name: str, bench: Bench, tool: str, draws: range) -> None:
    """Print the row of a tool."""
    module, identify = TOOLS[tool]
    rows: list[dict[str, np.ndarray]] = []
    seconds: list[float] = []
    for seed in draws:
        record = record_of(bench, seed)
        start = time.process_time()
        try:
            with _silence():
                found = identify(record, bench)
        except Exception as failure:  # of a tool that finds nothing
            if module is None:
                raise
            print(f"  {tool}: {failure}"[:110])
            continue
        seconds.append(time.process_time() - start)
        each = errors(found, bench)
        if each is not None:
            rows.append(each)
    line = f"| {name} | {tool} | {len(rows)} of {len(draws)} |"
    if rows:
        for part in ("frequency", "damping"):
            line += f" {100 * np.sqrt(np.mean([row[part] ** 2 for row in rows])):.3g} |"
        line += f" {np.mean([row['1 - MAC'] for row in rows]):.2g} |"
        for part in ("z of frequency", "z of damping", "z of shapes"):
            held = [np.abs(row[part]) < 1.96 for row in rows if part in row]
            line += f" {100 * np.mean(np.concatenate(held)):.1f} |" if held else " – |"
        line += f" {np.median(seconds):.2g} |"
    print(line, flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--alone", type=int, default=0)
    parser.add_argument("--case", choices=list(CASES), help="this one alone")
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    missing = []
    for tool, (module, _) in TOOLS.items():
        try:
            importlib.import_module(module or "dashpot")
        except ImportError:
            missing.append(tool)
    for tool in missing:
        print(f"{tool}: not installed, left out (pip install pyOMA-2 sdypy-EMA)")
    print(
        "| case | tool | all modes found | frequency, % | damping, % | 1 − MAC | held: f | ζ | shapes, % | s |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name, bench in CASES.items():
        if options.case not in (None, name):
            continue
        for tool in TOOLS:
            if tool not in missing:
                run(name, bench, tool, range(options.draws))
        if options.alone:
            run(name, bench, "dashpot", range(1000, 1000 + options.alone))


if __name__ == "__main__":
    main()
