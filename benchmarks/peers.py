"""One record given to dashpot, to lmfit, to MuJoCo's sysid and to aeroid: error and stated interval, and time.

`python3 dev.py bench peers [--draws N] [--more N]`.  The paper's rig on a base that is stepped through the frequencies
of its CASE-3, from rest, in one continuous record; with white noise of one size in each channel, which an ordinary
least squares of samples takes for granted, with the paper's, in proportion to the amplitude at each frequency, and
with noise on the base as well.

dashpot gets the rig: with the whole record, and with its settled dwells alone. lmfit gets dashpot's amplitudes with
their standard deviations, a hand-written response and a start. MuJoCo gets the samples, transients included, a
start and bounds: masses on slide joints, the spring and the damper between them a fixed tendon, those to the base a
position actuator (kp = k2) that follows u and a velocity actuator (kv = c2) that follows its rate. aeroid gets the
samples, the noise, the state of rest, a start and the equation of motion, with the base's samples joined by lines as
it documents, and with a spline of the base written out by its user.  What has not ended after
`--limit` seconds is left out.  dashpot also gets the record from the middle of its third dwell to that of its last but
two, moving at both ends.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import io
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass

import lmfit
import numpy as np
from scipy.linalg import expm
from scipy.special import stdtrit

from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.identify import identify
from dashpot.reproduce.yamane1989 import paper_model, paper_prints, true_rig

RIG, TRUTH = paper_model(), dict(paper_prints().values)
NAMES, TRUE = tuple(TRUTH), np.array(list(TRUTH.values()))
K1, K2 = paper_prints().known.values()
CHANNELS = true_rig().channels  # x1, x2, their velocities and u
CASE_3 = paper_prints().cases["CASE-3"]  # Hz
STROKE = 1e-3  # m
RATE = 100  # samples a second
STEPS = 5  # of MuJoCo's integrator in a sample
TRANSIENT = 0.5  # s: the slowest mode has fallen to e⁻⁸
MEASURED = 0.75  # s at least, and whole periods
NOISE = 0.1  # of a channel's size, standard deviation of each sample
AEROID = {"aeroid, base by lines": False, "aeroid, base by a spline": True}
FOUND = 0.2  # of the truth: what ends farther off in any parameter has not found it


@dataclass(frozen=True)
class Test:
    """The noise-free record, its motion at the integrator's finer times, and where each dwell is steady."""

    time: np.ndarray  # (samples,)
    values: np.ndarray  # (samples, 4): x1, x2, v1, v2
    base: np.ndarray  # (samples,)
    fine: np.ndarray  # (steps,) s
    command: np.ndarray  # (steps, 2): u and its rate half a step after each fine time
    dwells: tuple[tuple[float, slice], ...]


def stepped_sine() -> Test:
    """The rig's exact motion: a sine is a linear oscillator too, so one matrix exponential carries both on."""
    k, c = TRUTH, K1 + K2
    M = np.diag([k["m1"], k["m2"]])
    C = np.array([[k["c1"] + k["c3"], -k["c1"]], [-k["c1"], k["c1"] + k["c2"] + k["c4"]]])
    K = np.array([[K1, -K1], [-K1, c]])
    h = 1 / (RATE * STEPS)
    z = np.zeros(6)  # x1, x2, v1, v2, u, u̇/ω
    states, commands, dwells = [z[None, :4]], [], []
    base, begun = [0.0], 0
    for hz in CASE_3:
        omega = 2 * np.pi * hz
        A = np.zeros((6, 6))
        A[:2, 2:4] = np.eye(2)
        A[2:4, :2], A[2:4, 2:4] = -np.linalg.solve(M, K), -np.linalg.solve(M, C)
        A[3, 4:] = np.array([K2, k["c2"] * omega]) / k["m2"]
        A[4, 5], A[5, 4] = omega, -omega
        z[4:] = z[4], np.sqrt(STROKE**2 - z[4] ** 2) * (1 if z[5] >= 0 else -1)
        half, whole = expm(A * h / 2), expm(A * h)
        periods = np.ceil(MEASURED * hz)
        samples = round((TRANSIENT + periods / hz) * RATE)
        path = np.empty((samples * STEPS, 6))
        for i in range(len(path)):
            middle = half @ z
            commands.append([middle[4], omega * middle[5]])
            z = whole @ z
            path[i] = z
        states.append(path[STEPS - 1 :: STEPS, :4])
        base.extend(path[STEPS - 1 :: STEPS, 4])
        dwells.append((float(hz), slice(begun + 1 + round(TRANSIENT * RATE), begun + 1 + samples)))
        begun += samples
    fine = np.arange(len(commands) + 1) * h
    return Test(
        np.arange(begun + 1) / RATE, np.concatenate(states), np.array(base), fine,
        np.array([*commands, commands[-1]]), tuple(dwells),
    )  # fmt: skip


def amplitudes(test: Test, values: np.ndarray) -> Spectrum:
    """Amplitudes and their noise from the steady part of each dwell; values (samples, 5), the base last."""
    dwells = [Record(CHANNELS, test.time[part], values[part], hz) for hz, part in test.dwells]
    return spectrum(dwells, transients="none")


def by_whole_record(
    test: Test, values: np.ndarray, part: slice = slice(None)
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `by_dashpot`, from all samples, transients included; the noise and the starting state are unknown to it."""
    return by_dashpot(spectrum([Record(CHANNELS, test.time[part], values[part])]))


def cut(test: Test) -> slice:
    """The samples between the middles of the third dwell and of the last but two."""
    (_, first), (_, last) = test.dwells[2], test.dwells[-3]
    return slice((first.start + first.stop) // 2, (last.start + last.stop) // 2)


def by_dashpot(data: Spectrum) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values, standard deviations and half widths of the 95 % intervals."""
    found = identify(RIG, data)
    return found.values, found.sd, found.interval()[1] - found.values


def by_lmfit(data: Spectrum, start: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Output error: weighted least squares of the amplitudes of x1, x2, v1 and v2."""
    s, U = 1j * data.omega, data.amplitudes[:, 4]
    measured, sd = data.amplitudes[:, :4], data.sd()[:, :4]

    def residual(p: lmfit.Parameters) -> np.ndarray:
        m1, m2, c1, c2, c3, c4 = (p[name].value for name in NAMES)
        d11 = s * s * m1 + s * (c1 + c3) + K1
        d12 = -(s * c1 + K1)
        d22 = s * s * m2 + s * (c1 + c2 + c4) + K1 + K2
        X2 = (s * c2 + K2) * U / (d22 - d12 * d12 / d11)
        X1 = -d12 * X2 / d11
        r = (np.stack([X1, X2, s * X1, s * X2], axis=-1) - measured) / sd
        return np.concatenate([r.real.ravel(), r.imag.ravel()])

    parameters = lmfit.Parameters()
    for name, value in zip(NAMES, start, strict=True):
        parameters.add(name, value=value)
    found = lmfit.minimize(residual, parameters, scale_covar=False)
    errors = [found.params[name].stderr for name in NAMES]
    sd_found = np.array([np.nan if error is None else error for error in errors])
    return np.array([found.params[name].value for name in NAMES]), sd_found, 1.96 * sd_found


MJCF = f"""
<mujoco>
  <option timestep="{1 / (RATE * STEPS)}" integrator="RK4" gravity="0 0 0"><flag contact="disable"/></option>
  <worldbody>
    <body name="one">
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="x1" type="slide" axis="1 0 0" damping="1"/>
    </body>
    <body name="two">
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="x2" type="slide" axis="1 0 0" damping="1"/>
    </body>
  </worldbody>
  <tendon>
    <fixed name="link" stiffness="{K1}" damping="1" springlength="0">
      <joint joint="x1" coef="1"/><joint joint="x2" coef="-1"/>
    </fixed>
  </tendon>
  <actuator><position name="u" joint="x2" kp="{K2}"/><velocity name="rate" joint="x2" kv="1"/></actuator>
</mujoco>
"""


def mujoco_solver(
    test: Test,
) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """A function from noisy values and a start to what MuJoCo's sysid states.  ImportError where it cannot be had."""
    import mujoco
    from mujoco import sysid

    if not hasattr(sysid, "optimize"):
        raise ImportError("mujoco is installed without what its sysid needs")
    from absl import logging

    logging.set_verbosity(logging.ERROR)
    spec = mujoco.MjSpec.from_string(MJCF)
    rig = spec.compile()
    rest = sysid.create_initial_state(rig, np.zeros(2), np.zeros(2))
    control = sysid.TimeSeries.from_control_names(test.fine, test.command, rig)
    # The states of the rollout: what its sensors return after a step is from before it.
    position, velocity = sysid.SignalType.MjStateQPos, sysid.SignalType.MjStateQVel
    signals = [("x1_qpos", position), ("x2_qpos", position), ("x1_qvel", velocity), ("x2_qvel", velocity)]

    def first(vector: np.ndarray, value: float) -> None:
        vector[0] = value

    def base_damper(spec: mujoco.MjSpec, value: float) -> None:
        actuator = spec.actuator("rate")
        actuator.gainprm[0], actuator.biasprm[2] = value, -value

    writers: dict[str, Callable[[mujoco.MjSpec, float], None]] = {
        "m1": lambda spec, value: setattr(spec.body("one"), "mass", value),
        "m2": lambda spec, value: setattr(spec.body("two"), "mass", value),
        "c1": lambda spec, value: first(spec.tendon("link").damping, value),
        "c2": base_damper,
        "c3": lambda spec, value: first(spec.joint("x1").damping, value),
        "c4": lambda spec, value: first(spec.joint("x2").damping, value),
    }

    def solve(values: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        measured = sysid.TimeSeries.from_names(test.time, values, rig, names=signals)
        sequences = sysid.ModelSequences(
            "rig", spec, "sweep", rest, control, measured, allow_missing_sensors=True
        )
        parameters = sysid.ParameterDict()
        for name, value in zip(NAMES, start, strict=True):
            parameters.add(
                sysid.Parameter(
                    name, value, value / 10, 10 * value,
                    modifier=lambda spec, p, write=writers[name]: write(spec, float(p.value[0])),
                )
            )  # fmt: skip
        residual = sysid.build_residual_fn(models_sequences=[sequences])
        # Its Jacobian, which the intervals need, comes only with the fullest of its outputs.
        found, result = sysid.optimize(parameters, residual, verbose=False, output=io.StringIO())
        left, _, _ = residual(result.x, found)
        _, half = sysid.calculate_intervals(left, result.jac)
        return result.x, half / stdtrit(left[0].size - len(NAMES), 0.975), half

    return solve


def aeroid_solver(
    test: Test, *, spline: bool
) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """A function from noisy values (samples, 5), the base last, and a start to what aeroid states.

    As documented it joins the samples of its controls, the base and its rate by differences, by lines; with `spline`
    its user has written out a cubic spline of the base in the equation of motion.  It starts from rest, and is told
    the noise of each channel.  ImportError where it cannot be had.
    """
    import aeroid
    from scipy.interpolate import CubicSpline

    def solve(values: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        pieces = CubicSpline(test.time, values[:, 4]).c.T.tolist()

        def dynamics(t: float, x: np.ndarray, u: np.ndarray, p: dict[str, float]) -> list[float]:
            base, speed = u[0], u[1]
            if spline:
                k = min(int(t * RATE), len(pieces) - 1)
                (c3, c2, c1, c0), h = pieces[k], t - k / RATE
                base, speed = ((c3 * h + c2) * h + c1) * h + c0, (3 * c3 * h + 2 * c2) * h + c1
            link = K1 * (x[0] - x[1]) + p["c1"] * (x[2] - x[3])
            foot = K2 * (x[1] - base) + p["c2"] * (x[3] - speed)
            first = -link - p["c3"] * x[2]
            return [x[2], x[3], first / p["m1"], (link - foot - p["c4"] * x[3]) / p["m2"]]

        model = aeroid.Model(
            states=("x1", "x2", "v1", "v2"), controls=("u", "rate"),
            parameters=dict(zip(NAMES, start.tolist(), strict=True)), dynamics=dynamics,
        )  # fmt: skip
        channels = dict(zip(model.states, values[:, :4].T, strict=True))
        controls = {"u": values[:, 4], "rate": np.gradient(values[:, 4], test.time)}
        rms = np.sqrt(np.mean(test.values**2, axis=0))
        found = aeroid.identify(
            model, aeroid.FlightData(test.time, {**channels, **controls}), list(NAMES), x0=np.zeros(4),
            weights=dict(zip(model.states, (1 / (NOISE * rms)).tolist(), strict=True)),
        )  # fmt: skip
        estimate = np.array([found.parameters[name] for name in NAMES])
        sd = np.array([found.stderr[name] for name in NAMES])
        return estimate, sd, 1.96 * sd

    return solve


@dataclass(frozen=True)
class Row:
    """What one tool gave over the draws."""

    values: np.ndarray
    sd: np.ndarray
    half: np.ndarray
    seconds: float

    def figures(self) -> str:
        off = np.abs(self.values / TRUE - 1)
        with np.errstate(invalid="ignore"):
            found = np.all(off < FOUND, axis=-1) & np.all(np.isfinite(self.sd), axis=-1)
        if np.count_nonzero(found) < 2:
            return f"{100 * np.mean(found):.0f} | – | – | – | – | {1e3 * self.seconds:.0f}"
        values, sd, half = self.values[found], self.sd[found], self.half[found]
        error = 100 * np.sqrt(np.mean((values / TRUE - 1) ** 2))
        bias = 100 * np.max(np.abs(np.mean(values, axis=0) / TRUE - 1))
        inside = 100 * np.mean(np.abs(values - TRUE) <= half)
        ratio = np.mean(np.mean(sd, axis=0) / np.std(values, axis=0, ddof=1))
        return (
            f"{100 * np.mean(found):.0f} | {error:.2f} | {bias:.2f} | {inside:.1f} | {ratio:.2f} | "
            f"{1e3 * self.seconds:.0f}"
        )


def measure(
    draws: int, solve: Callable[[int], tuple[np.ndarray, np.ndarray, np.ndarray]], limit: int
) -> Row | None:
    """All draws by one tool; the time is the median of the processor's.  None where one takes more than `limit` s."""
    found, seconds = [], []
    signal.signal(signal.SIGPROF, _too_long)
    try:
        for draw in range(draws):
            signal.setitimer(signal.ITIMER_PROF, limit)
            begin = time.process_time()
            found.append(solve(draw))
            seconds.append(time.process_time() - begin)
    except TimeoutError:
        return None
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    values, sd, half = (np.array(part) for part in zip(*found, strict=True))
    return Row(values, sd, half, float(np.median(seconds)))


def _too_long(number: int, frame: object) -> None:
    raise TimeoutError


def levels(test: Test) -> dict[str, np.ndarray]:
    """Standard deviations of the noise of each sample, (samples, 5) or (5,), the base last."""
    everything = np.column_stack([test.values, test.base])
    rms = np.sqrt(np.mean(everything**2, axis=0))
    in_proportion = np.zeros_like(everything)
    begin = 0
    for _, part in test.dwells:
        in_proportion[begin : part.stop, :4] = np.sqrt(2 * np.mean(test.values[part] ** 2, axis=0))
        begin = part.stop
    size, moving = f"{100 * NOISE:.0f} %", np.array([1, 1, 1, 1, 0])
    return {
        f"{size} of each channel's rms, the same at all frequencies; the base exact": NOISE * rms * moving,
        f"{size} of the amplitude at each frequency (eq. 21); the base exact": NOISE * in_proportion,
        f"{size} of each channel's rms, the base measured like the masses": NOISE * rms,
    }


def wobble(rng: np.random.Generator, base: np.random.Generator, samples: int) -> np.ndarray:
    """White noise, (samples, 5); the base has a generator of its own, so that it does not change the others' noise."""
    return np.column_stack([rng.standard_normal((samples, 4)), base.standard_normal(samples)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--draws", type=int, default=20, help="of the noise, for all tools alike")
    parser.add_argument("--more", type=int, default=300, help="for the tools that take milliseconds")
    parser.add_argument(
        "--limit", type=int, default=600, help="seconds of the processor that one fit may take"
    )
    given = parser.parse_args()
    draws, more = given.draws, max(given.draws, given.more)
    test = stepped_sine()
    try:
        by_mujoco = mujoco_solver(test)
    except ImportError as failure:
        by_mujoco = None
        print(f"mujoco is left out: {failure}\n")
    else:
        exact, _, _ = by_mujoco(test.values, 1.5 * TRUE)
        print(
            f"mujoco {importlib.metadata.version('mujoco')}, integrator RK4 with {1e3 / (RATE * STEPS):g} ms: from the "
            f"record without noise its parameters are {100 * np.max(np.abs(exact / TRUE - 1)):.2f} % off at most.\n"
        )
    try:
        by_aeroid = {name: aeroid_solver(test, spline=spline) for name, spline in AEROID.items()}
    except ImportError as failure:
        by_aeroid = {}
        print(f"aeroid is left out: {failure}\n")
    endless: set[str] = set()
    for number, (words, level) in enumerate(levels(test).items()):
        rng, base_rng = np.random.default_rng([1989, number]), np.random.default_rng([1989, number, 1])
        clean = np.column_stack([test.values, test.base])
        noisy = [clean + level * wobble(rng, base_rng, len(clean)) for _ in range(more)]
        begin = time.perf_counter()
        data = [amplitudes(test, values) for values in noisy]
        making = (time.perf_counter() - begin) / more
        steady = sum(part.stop - part.start for _, part in test.dwells)
        print(
            f"Noise {words}: {test.time[-1]:.1f} s, {len(test.time)} samples of 4 channels, {steady} of them steady\n"
        )
        print(
            "| tool | start | draws | found the truth, % | rms relative error, % | largest bias, % "
            "| 95 % intervals that hold the truth, % | stated sd over spread | processor time, ms |"
        )
        print("|---|---|---|---|---|---|---|---|---|")
        quick = [
            ("dashpot, whole record", "none", lambda k, noisy=noisy: by_whole_record(test, noisy[k])),
            (
                "dashpot, cut within two dwells",
                "none",
                lambda k, noisy=noisy: by_whole_record(test, noisy[k], cut(test)),
            ),
            ("dashpot oiv, settled dwells", "none", lambda k, data=data: by_dashpot(data[k])),
            ("lmfit", "1.5 × truth", lambda k, data=data: by_lmfit(data[k], 1.5 * TRUE)),
            ("lmfit", "5 × truth", lambda k, data=data: by_lmfit(data[k], 5 * TRUE)),
        ]
        rows = [(*row, draws) for row in quick]
        exact_base = not np.any(level[..., 4])
        if by_mujoco is not None and exact_base:
            rows.append(
                (
                    "mujoco.sysid", "1.5 × truth",
                    lambda k, noisy=noisy: by_mujoco(noisy[k][:, :4], 1.5 * TRUE), draws,
                )
            )  # fmt: skip
        for name, solver in by_aeroid.items():
            rows.append((
                name, "1.5 × truth", lambda k, noisy=noisy, solver=solver: solver(noisy[k], 1.5 * TRUE), draws,
            ))  # fmt: skip
        rows += [(*row, more) for row in quick]
        for tool, start, solve, count in rows:
            row = None if tool in endless else measure(count, solve, given.limit)
            endless |= {tool} if row is None else set()
            figures = (
                f"not every fit ended in {given.limit} s | – | – | – | – | –"
                if row is None
                else row.figures()
            )
            print(f"| {tool} | {start} | {count} | {figures} |", flush=True)
        if not exact_base:
            print("| mujoco.sysid | – | – | its control is an exact motion | – | – | – | – | – |")
        elif by_mujoco is None:
            print("| mujoco.sysid | 1.5 × truth | not installed | – | – | – | – | – | – |")
        print(f"\nThe amplitudes for dashpot and lmfit take another {1e3 * making:.0f} ms.\n")


if __name__ == "__main__":
    main()
