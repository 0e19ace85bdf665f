"""Default conditioning against the best options known afterwards, on simulated tests with all that goes wrong.

`python3 dev.py bench conditioning`, or with `--tests 1000 --coverage` the number that is claimed. Each test is a
stepped sine of a rig of two coordinates at eight frequencies: one to fifty periods a dwell, 12 to 40 samples a
period, 0.3 to 5 % noise, and some of: a converter of 8 to 16 bits, an offset with a slope, stated frequencies off by
up to 2 %, jitter of the stamps, mains hum, transients from dwell to dwell, a channel that clips, a drive whose
amplitude drifts by up to 6 % within a dwell. Printed are, for each of these, how many 95 % intervals hold the truth and
the rms error over that of whichever of ten sets of options does best there, known afterwards. Errors are
counted in deviations of the Cramér-Rao bound (the median of all answers to the test): a
test whose answers happen to lie near the truth then decides no row.

`--samples 8 11` makes dwells of so few samples, four a period at least; `--one` a test of one dwell, of one mass.

`--converter` prints instead how often 95 % regions hold the amplitude of a sine that a coarse converter rounds, by its
steps from end to end and noise in steps, and the milliseconds of processor time that a dwell takes.

With `--kept FILE` each test is a line of that file, and those already in it are not done again: a long run may be cut
and go on, or be shared out to processes of which each has its own `--tests` and `--seed`, and the table is of all.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.special import fdtr

from dashpot.arrays import Bools, Real
from dashpot.channel import Channel
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.record import Record
from dashpot.errors import DashpotError
from dashpot.estimate.automatic import identify_with_noise
from dashpot.model.motion import channel_samples, integrator
from dashpot.model.network import Model
from dashpot.model.observation import observation_model

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.whole_rigs import chain, record_of

FREQUENCIES = (4.0, 5.2, 6.5, 8.0, 10.0, 12.5, 15.0, 18.0)
ONE = (6.5,)  # above and below the resonances of one mass and of two
TROUBLES = ("quantised", "slope", "frequency", "jitter", "hum", "transients")
LATER = ("clipped", "fading")  # drawn by a generator of their own: tests of the others stay what they were
OPTIONS = {
    f"drift {drift}, refine {refine}, transients {transients}, noise {noise}": Conditioning(
        drift=drift, refine=refine, transients=transients, noise=noise
    )
    for drift in (0, 1)
    for refine, transients, noise in (
        ("none", "none", "white"),
        ("none", "none", "auto"),
        ("auto", "none", "auto"),
        ("always", "none", "auto"),
        ("none", "estimate", "auto"),
    )
}


WORST = 10.0  # times the bound: beyond it a treatment has failed
LEAST_A_PERIOD = 4  # samples, of tests of few


@dataclass(frozen=True)
class Plan:
    """What is tested: a rig, its true unknowns, where it is driven, for how long.

    periods: of a dwell, at most; samples: of a dwell, from the first number to the second, or as many as come
    """

    model: Model
    theta: Real
    channels: tuple[Channel, ...]
    frequencies: tuple[float, ...] = FREQUENCIES
    periods: float = 50.0
    samples: tuple[int, int] | None = None

    @staticmethod
    def of(
        masses: int, frequencies: tuple[float, ...], periods: float, samples: tuple[int, int] | None
    ) -> Plan:
        """For so many masses in a row on a base that moves."""
        model, theta = chain(masses, 0.08, seed=1)
        channels = record_of(model, theta, "random", decay_times=0.1).record.channels
        return Plan(model, theta, channels, frequencies, periods, samples)

    def drawn(self, rng: np.random.Generator) -> tuple[float, float, int]:
        """Periods, samples a period, and samples of a dwell."""
        if self.samples is None:
            periods, each = float(np.exp(rng.uniform(0, np.log(self.periods)))), int(rng.integers(12, 41))
            return periods, each, max(int(each * periods), 16)
        count = int(rng.integers(self.samples[0], self.samples[1] + 1))
        most = max(min(self.periods, count / LEAST_A_PERIOD), 1.0)
        periods = float(np.exp(rng.uniform(0, np.log(most))))
        return periods, count / periods, count


def dwells(plan: Plan, rng: np.random.Generator, troubles: frozenset[str]) -> list[Record]:
    """One test."""
    p, view = plan.model.parameters(plan.theta), observation_model(plan.model, plan.channels, np.ones(1))
    _, each, samples = plan.drawn(rng)
    noise = float(np.exp(rng.uniform(np.log(0.003), np.log(0.05))))
    stated = 1 + rng.uniform(-0.02, 0.02) * ("frequency" in troubles)
    slope, bits = rng.uniform(0.02, 0.3) * ("slope" in troubles), int(rng.integers(8, 17))
    state: Real = np.zeros(2 * plan.model.n)
    own = np.random.default_rng(rng.integers(2**32) if {"clipped", "fading"} & troubles else 0)
    records = []
    for f in plan.frequencies:
        fade, limit = own.uniform(-0.03, 0.03), own.uniform(1.1, 1.4)
        step = 1 / (each * f)
        wait = 0 if "transients" in troubles else int(4.0 / step)
        count = wait + samples
        fine = np.arange(8 * count + 1) * step / 8
        drive = np.sin(2 * np.pi * f * fine) * 1e-3
        if "fading" in troubles:  # in what is recorded: as it settles, the drive is even
            drive *= 1 + fade * np.interp(fine, [wait * step, fine[-1]], [-1, 1])
        motion = integrator(plan.model, p, step / 8).motion(drive[:, None], state)
        state = np.concatenate([motion.x[-1], motion.v[-1]])
        y = channel_samples(view, p, motion)[:-1:8][wait:]
        t, size = step * np.arange(len(y)), np.std(y, axis=0)
        if "jitter" in troubles:
            shifted = t + 0.02 * step * rng.normal(size=len(t))
            y = np.stack([np.interp(shifted, t, column) for column in y.T], axis=1)
        y = y + noise * size * rng.normal(size=y.shape)
        y = y + slope * size * np.linspace(-1, 1, len(t))[:, None] * rng.normal(size=y.shape[1])
        if "hum" in troubles:
            y = y + 0.02 * size * np.sin(2 * np.pi * 50 * t + rng.uniform(0, 6))[:, None]
        if "clipped" in troubles:
            y[:, 0] = np.clip(y[:, 0], -limit * size[0], limit * size[0])
        if "quantised" in troubles:
            code = 4 * size / 2**bits
            y = np.round(y / code) * code
        records.append(Record(plan.channels, t, y, f * stated))
    return records


@dataclass(frozen=True)
class Answer:
    """Errors and the smallest deviations that data allow, over the truth, and whether intervals hold it, (M,)."""

    error: Real
    bound: Real
    held: Bools


def answer(plan: Plan, records: list[Record], conditioning: Conditioning | None) -> Answer | None:
    """What identification makes of a test; None where it refuses."""
    try:
        estimate = identify_with_noise(plan.model, spectrum(records, conditioning))[0]
    except DashpotError:
        return None
    low, high = np.array([estimate[name].interval95 for name in estimate.names]).T
    truth = plan.theta
    return Answer(
        estimate.values / truth - 1, estimate.bound_sd / np.abs(truth), (low <= truth) & (high >= truth)
    )


def sizes(answers: list[Answer | None]) -> Real:
    """Rms errors of the answers to one test, in units that are alike for all of them and from test to test."""
    unit = np.median([a.bound for a in answers if a is not None], axis=0)
    return np.array([np.inf if a is None else np.sqrt(np.mean((a.error / unit) ** 2)) for a in answers])


def over_the_best(errors: Real, rng: np.random.Generator) -> tuple[float, float, int]:
    """Rms of the defaults over that of the best option, its standard error, and which option that is.

    errors (tests, 1 + options); the standard error is that of 200 draws from the tests.
    """
    squares = np.minimum(errors, WORST) ** 2
    rms = np.sqrt(np.mean(squares, axis=0))
    best = 1 + int(np.argmin(rms[1:]))
    drawn = np.mean(squares[rng.integers(len(squares), size=(200, len(squares)))], axis=1)
    return float(rms[0] / rms[best]), float(np.std(np.sqrt(drawn[:, 0] / drawn[:, best]))), best - 1


@dataclass(frozen=True)
class Tried:
    """What one test gave: its troubles, whether the defaults' intervals hold the truth, and errors of all options.

    held is empty where the defaults gave no answer.
    """

    seed: int
    troubles: list[str]
    held: list[bool]
    errors: list[float]


def tried(plan: Plan, seed: int, only: str | None, others: Iterable[Conditioning]) -> Tried:
    """One test, by the defaults and by other options."""
    rng = np.random.default_rng(seed)
    drawn = frozenset(t for t in TROUBLES if rng.random() < 0.25)
    later = np.random.default_rng([seed, 1])
    drawn |= frozenset(t for t in LATER if later.random() < 0.25)
    chosen = frozenset([only]) if only else drawn
    records = dwells(plan, rng, chosen)
    usual = answer(plan, records, None)
    if usual is None:
        return Tried(seed, sorted(chosen), [], [])
    answers = [usual, *(answer(plan, records, conditioning) for conditioning in others)]
    return Tried(seed, sorted(chosen), usual.held.tolist(), sizes(answers).tolist())


def show(tests: list[Tried], coverage: bool) -> None:
    """The table of all tests."""
    print(
        f"{'':12}{'tests':>6}{'coverage':>10}" + ("" if coverage else f"{'over the best':>21}  best option")
    )
    answered = [test for test in tests if test.held]
    for trouble in ("nothing", *TROUBLES, *LATER, "all"):
        some = [test for test in answered if trouble in (*(test.troubles or ["nothing"]), "all")]
        if not some:
            continue
        row = f"{trouble:12}{len(some):6}{100 * np.mean([test.held for test in some]):9.1f}%"
        if not coverage:
            errors = np.array([test.errors for test in some])
            ratio, spread, best = over_the_best(errors, np.random.default_rng(0))
            row += f"{ratio:13.3f} ± {spread:5.3f}  {list(OPTIONS)[best]}"
        print(row)
    print(f"{len(tests) - len(answered)} without an answer")


def converter(tests: int) -> None:
    """Rows of dwells of 1.5 to 40 periods of 12 to 40 samples, every second with a whole number of them in a period."""
    print(f"{'steps':>6}{'noise':>7}{'coverage':>10}{'(error/sd)²':>13}{'ms':>6}")
    channels = (Channel("x1", {"x1": 1}), Channel("u", {"u": 1}))
    for noise in (0.02, 0.1, 0.3):
        for steps in (1, 2, 4, 16, 64, 256, 1024, 4096):
            rng, squares, held, took = np.random.default_rng([1, steps, int(100 * noise)]), [], [], 0.0
            for k in range(tests):
                periods, each = np.exp(rng.uniform(np.log(1.5), np.log(40))), rng.uniform(12, 40)
                each = round(each) if k % 2 else each
                t = np.arange(int(periods * each)) / (4.0 * each)
                size = steps / 2 * np.exp(1j * rng.uniform(0, 2 * np.pi))
                values = np.real(np.exp(8j * np.pi * t)[:, None] * np.array([size, 1.0]))
                values[:, 0] = np.round(
                    values[:, 0] + rng.uniform(-0.5, 0.5) + noise * rng.normal(size=len(t))
                )
                values[:, 1] += 1e-3 * rng.normal(size=len(t))
                took -= time.process_time()
                lines = spectrum([Record(channels, t, values, 4.0)], transients="none", refine="none")
                took += time.process_time()
                squares.append(abs(lines.amplitudes[0, 0] - size) ** 2 / lines.covariance[0, 0, 0].real)
                held.append(fdtr(2, lines.dof[0], squares[-1]) < 0.95)
            row = f"{steps:6}{noise:7}{100 * np.mean(held):9.1f}%{np.mean(squares):13.2f}"
            print(f"{row}{1e3 * took / tests:6.0f}", flush=True)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--tests", type=int, default=60)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument(
        "--only", choices=(*TROUBLES, *LATER), help="nothing but this trouble, in every test"
    )
    options.add_argument("--periods", type=float, default=50.0, help="of a dwell, at most")
    options.add_argument("--samples", type=int, nargs=2, help="of a dwell, from and to (8 11)")
    options.add_argument("--one", action="store_true", help="one mass and one dwell")
    options.add_argument(
        "--coverage", action="store_true", help="the defaults alone, ten times as many in a time"
    )
    options.add_argument("--kept", type=Path, help="file of tests done, which is added to")
    options.add_argument("--minutes", type=float, default=60.0, help="after which no other test is begun")
    options.add_argument("--converter", action="store_true", help="amplitudes that a coarse converter rounds")
    settings = options.parse_args()
    if settings.converter:
        converter(settings.tests)
        return
    done: list[Tried] = []
    if settings.kept is not None and settings.kept.exists():
        done = [Tried(**json.loads(line)) for line in settings.kept.read_text().splitlines()]
    few = None if settings.samples is None else (settings.samples[0], settings.samples[1])
    frequencies, masses = (ONE, 1) if settings.one else (FREQUENCIES, 2)
    plan = Plan.of(masses, frequencies, settings.periods, few)
    known, start = {test.seed for test in done}, time.perf_counter()
    for seed in range(settings.seed, settings.seed + settings.tests):
        if time.perf_counter() - start > 60 * settings.minutes:
            break
        if seed in known:
            continue
        others = () if settings.coverage else OPTIONS.values()
        done.append(tried(plan, seed, settings.only, others))
        if settings.kept is not None:
            with settings.kept.open("a") as file:
                file.write(json.dumps(asdict(done[-1])) + "\n")
    show(done, settings.coverage)


if __name__ == "__main__":
    main()
