"""Linear rigs fitted to whole records of nonlinear ones, made by SciPy's integrator: the element is named."""

import runpy
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from dashpot.api import identify, read
from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.noise import noise_at_rest
from dashpot.data.record import Record
from dashpot.errors import IdentifiabilityError
from dashpot.estimate.assessment import Finding, applied
from dashpot.estimate.nonlinear.whole_record import fit_records
from dashpot.estimate.result import Estimate
from dashpot.model.elements import Kind, between
from dashpot.model.network import Model
from dashpot.model.nonlinear.force_law import Constant, force_law
from dashpot.model.rigfile import Rig, read_rig
from tests.networks import network

Law = Callable[[float, float], float]
STEP, SAMPLES = 1 / 50, 1500
LAWS: dict[str, tuple[Law, str, str]] = {
    "cubic": (lambda d, v: 2e6 * d**3, "k3", "odd, stiffening"),
    "square": (lambda d, v: 4e4 * d**2, "k2", "even"),
    "speed": (lambda d, v: 60 * v * abs(v), "cq", "damping that grows with speed"),
    "friction": (lambda d, v: 0.3 * np.tanh(v / 0.005), "fc", "friction"),
    "stop": (lambda d, v: 1500 * min(d + 0.002, 0), "kstop", "with a clearance on one side"),
    "gap": (lambda d, v: 1500 * (max(d - 0.0027, 0) + min(d + 0.0027, 0)), "kgap", "with a clearance"),
}
ROOT = Path(__file__).parents[4]
CHANNELS = (Channel("x", {"x": 1.0}), Channel("u", {"u": 1.0}))


def shaken() -> Model:
    """One mass, known, on a shaken base."""
    return network("x", "u", "m@x=2 k:x-u c:x-u")


def recorded(law: Law | None, noise: float = 0.01, sweep: bool = False) -> Record:
    """Its motion with one more force between mass and base."""
    rng = np.random.default_rng(7)
    time = STEP * np.arange(SAMPLES)
    if sweep:
        base = 1.5e-3 * np.sin(2 * np.pi * (0.5 + 5 * time / time[-1] / 2) * time)
    else:
        tones, phases = rng.uniform(0.5, 6, 30), rng.uniform(0, 6.3, 30)
        base = 4e-4 * np.sum(np.cos(2 * np.pi * tones * time[:, None] + phases), axis=1)
    u = CubicSpline(time, base)
    rate = u.derivative()

    def rates(t: float, s: Real) -> list[float]:
        d, v = float(s[0] - u(t)), float(s[1] - rate(t))
        extra = 0.0 if law is None else law(d, v)
        return [s[1], -(800 * d + 4 * v + extra) / 2]

    x = solve_ivp(rates, (0, time[-1]), [0, 0], t_eval=time, rtol=1e-7, atol=1e-10).y[0]
    seen = x + noise * np.std(x) * rng.standard_normal(SAMPLES)
    return Record(CHANNELS, time, np.stack([seen, base], axis=1))


@cache
def under(name: str) -> tuple[Record, Estimate]:
    """A record with that law, and the linear rig fitted to it and judged."""
    record = recorded(LAWS[name][0])
    return record, fitted(record)


def fitted(record: Record) -> Estimate:
    """The linear rig, judged."""
    return identify(shaken(), [record], "ml", diagnose=True)


def nonlinear(estimate: Estimate) -> list[Finding]:
    """Findings of that kind."""
    return [finding for finding in estimate.assessment.findings if finding.kind == "nonlinear"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["cubic", *(pytest.param(name, marks=pytest.mark.long) for name in LAWS if name != "cubic")]
)
def test_the_element_that_a_whole_record_calls_for_is_named_first(name: str) -> None:
    _, short, words = LAWS[name]
    _, estimate = under(name)
    assert estimate.assessment.verdict == "does not fit"
    assert estimate.assessment.reasons[0].code == "nonlinear"
    first = estimate.assessment.findings[0]
    joined = "u and x" if name == "stop" else "x and u"  # a stop on one side has a direction
    assert first.text.startswith(f"the data call for a nonlinear element between {joined}, ")
    assert first.text.endswith(" (p < 1e-6)")
    named = {finding.elements[0].name: finding.text for finding in nonlinear(estimate)}
    assert words in named[short]


@pytest.mark.long
def test_friction_below_zero_is_damping_that_grows_with_speed_and_the_line_says_so() -> None:
    """Less damping at low speeds than at high ones had been written as a Coulomb damper with a negative guess."""
    findings = nonlinear(fitted(recorded(lambda d, v: 4 * v - 0.1 * np.tanh(v / 0.004), noise=0.003)))
    assert "damping that grows with speed" in findings[0].text
    assert all(finding.number is not None and finding.number > 0 for finding in findings)
    assert "coulomb" not in findings[0].change


@pytest.mark.long
@pytest.mark.parametrize("missing", [True, False])
def test_the_refusal_of_a_gap_that_never_closes_names_a_missing_damper(missing: bool) -> None:
    rig, gap = shaken(), force_law("gap", [Constant("gap", 0.1)])
    stop = replace(between("q", Kind.SPRING, "x", "ground"), force_law=gap)
    kept = rig.elements[:2] if missing else rig.elements
    with pytest.raises(IdentifiabilityError, match="no information on q") as refused:
        identify(replace(rig, elements=(*kept, stop)), [recorded(None, noise=0.003)], judge=True)
    causes = [(each.kind, set(each.of)) for each in refused.value.causes]
    assert causes[:1] == [("element", {"x", "u"})] * missing


def test_the_remedy_makes_the_record_fit() -> None:
    record, linear = under("cubic")
    best = nonlinear(linear)[0]
    mended, _ = applied(shaken(), CHANNELS, best)
    estimate = fit_records(mended, [record]).estimate()
    k3 = estimate.names.index("k3")
    assert abs(estimate.values[k3] - 2e6) < 4 * estimate.sd[k3]


@pytest.mark.long
def test_a_sweep_to_which_no_linear_rig_comes_near_names_it_too() -> None:
    estimate = fitted(recorded(LAWS["cubic"][0], sweep=True))
    first = nonlinear(estimate)[0]
    assert first.of == ("x", "u")
    assert "odd, stiffening" in first.text


def clipped(x: Real) -> Real:
    """A channel that reaches its limits."""
    return np.clip(x, -1.5 * np.std(x), 1.5 * np.std(x))


@pytest.mark.slow
@pytest.mark.parametrize(
    "mistake",
    [
        None,
        lambda x: x * (1 + 0.1 * np.random.default_rng(3).standard_normal(len(x))),
        *(
            pytest.param(mistake, marks=pytest.mark.long)
            for mistake in (lambda x: -x, lambda x: np.roll(x, 2), clipped, lambda x: np.round(x / 2e-3) * 2e-3)
        ),
    ],
)  # fmt: skip
def test_records_of_a_linear_rig_call_for_none_whatever_is_wrong_with_a_channel(
    mistake: Callable[[Real], Real] | None,
) -> None:
    record = recorded(None)
    if mistake is not None:
        values = np.stack([mistake(record.values[:, 0]), record.values[:, 1]], axis=1)
        record = replace(record, values=values)
    assert nonlinear(fitted(record)) == []


EARTHQUAKE = ROOT / "examples" / "08_earthquake"


@pytest.fixture(scope="module")
def quake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the earthquake example's records."""
    folder = tmp_path_factory.mktemp("quake")
    runpy.run_path(str(EARTHQUAKE / "make_record.py"))["main"](folder)
    return folder


def frame(folder: Path, old: str, new: str) -> Rig:
    """The example's rig with something otherwise."""
    text = (EARTHQUAKE / "rig.toml").read_text(encoding="utf-8")
    assert old in text
    (folder / "rig.toml").write_text(text.replace(old, new, 1), encoding="utf-8")
    return read_rig(folder / "rig.toml")


@pytest.mark.long
def test_a_wrong_mass_is_named_first_though_no_noise_is_known(quake: Path) -> None:
    """It was "x1 reads 0.743 × as much after 11.24 s": lines without transients left too much of the misfit."""
    rows = (quake / "quake.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    (quake / "half.csv").write_text("".join(rows[:1500]), encoding="utf-8")
    estimate = identify(frame(quake, "0.9 kg", "0.87 kg"), quake / "half.csv", diagnose=True)
    assert estimate.assessment.verdict == "does not fit"
    first = estimate.assessment.findings[0]
    assert (first.kind, first.of) == ("value", ("m3",))
    assert first.number == pytest.approx(0.9, rel=2e-3)
    assert first.remaining is not None
    assert first.remaining < 1.4


@pytest.mark.long
def test_a_missing_damper_is_named_first_in_an_earthquake(quake: Path) -> None:
    rig = frame(quake, 'c2 = { between = ["x1", "x2"] }\n', "")
    estimate = identify(rig, quake / "quake.csv", diagnose=True)
    first = estimate.assessment.findings[0]
    assert (first.kind, first.of) == ("element", ("x1", "x2"))
    assert "dampers" in first.change


@pytest.mark.long
def test_a_wrong_mass_passes_for_no_nonlinear_element(quake: Path) -> None:
    """Its residuals go with the motion: a clearance explained half of them and led to a fit as bad as before."""
    rig = frame(quake, "1.2 kg", "1.8 kg")
    settings = Conditioning(still=noise_at_rest(read(quake / "still.csv", rig).records))
    estimate = identify(rig, quake / "quake.csv", diagnose=True, conditioning=settings)
    # The floors are met by another base than was measured, which no part of the floors' motion tells.
    assert estimate.assessment.relative_residual["base"] > 0.5
    first, *others = estimate.assessment.findings
    assert (first.kind, "m1" in first.change) == ("value", True)
    assert all(each.kind != "nonlinear" for each in (first, *others))
