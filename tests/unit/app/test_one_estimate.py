"""One estimate of one set of data, whoever is asked for it."""

import json
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType

import numpy as np
import pytest

from dashpot import api, identify, read_rig
from dashpot.channel import Channel
from dashpot.check.identifiability import determines
from dashpot.data.readers import write_amplitudes, write_records
from dashpot.errors import ConvergenceError
from dashpot.estimate.assessment import Finding
from dashpot.estimate.result import Estimate
from dashpot.fleet.data_sets import Treatment, of_files
from dashpot.fleet.runner import run_fleet
from dashpot.model.observation import with_relative_noise
from dashpot.model.rigfile import Rig, write_rig
from dashpot.study.montecarlo import Task, generator, repeats_of
from dashpot.study.scenario import AUTO, Scenario
from dashpot.study.simulate import dwells
from tests import rigs
from tests.two_masses import RIG as TWO_MASSES
from tests.two_masses import one_mass
from tests.unit.app.conftest import SET, Command

SAME = 1e-9  # of a standard deviation


def calibrated(channels: tuple[Channel, ...], k: int) -> tuple[Channel, ...]:
    """Of every third rig none, else the first channel of known gain, or of one that is to be found."""
    first = replace(channels[0], gain=(1.0, 1.1, None)[k % 3])
    return (first, *channels[1:])


@pytest.mark.slow
@pytest.mark.parametrize("k", range(6))
def test_commands_python_and_a_study_give_one_estimate(k: int, dashpot: Command) -> None:
    rng = np.random.default_rng([2027, k])
    drawn = rigs.random_rig(rng, 1 + k % 3, forces=k % 2, lines=12, worst=100)
    plain = rigs.channels(drawn)
    rig = Rig(drawn.model, calibrated(plain, k))
    gains = np.array([1.1 if channel.gain == 1.1 else 1.0 for channel in rig.channels])
    measured = [
        replace(one, values=one.values * gains)
        for one in rigs.records(drawn, plain, rng, samples=96, periods=6, relative=0.02)
    ]
    Path("rig.toml").write_text(write_rig(rig), encoding="utf-8")
    write_records([replace(one, channels=rig.channels) for one in measured], "data.csv")

    told = dashpot("identify", "rig.toml", "data.csv", "--json", "estimate.json", "--quiet")
    assert told.code == 0, told.err
    content = json.loads(Path("estimate.json").read_text(encoding="utf-8"))["parameters"]
    read = read_rig("rig.toml")
    from_path = identify(read, "data.csv")
    from_records = identify(read, measured)  # of channels that state no calibration
    assert from_path.names == from_records.names
    assert from_records.values == pytest.approx(from_path.values, abs=SAME * from_path.sd.min(), rel=1e-12)
    for name, value, sd in zip(from_path.names, from_path.values, from_path.sd, strict=True):
        found = content[name]["value"]
        assert abs(found - value) <= SAME * sd + 1e-12 * abs(value), name

    first = drawn.model.unknown_names[0]
    assert dashpot("check", "rig.toml", "data.csv", "--profile", first, "--json", "check.json").code == 0
    [profile] = json.loads(Path("check.json").read_text(encoding="utf-8"))["profiles"]
    assert abs(profile["value"] - content[first]["value"]) <= SAME * content[first]["sd"]


@pytest.mark.parametrize("k", range(6))
@pytest.mark.parametrize("method", ["ml", None])
def test_a_draw_of_a_study_is_identified_as_data_are(k: int, method: str | None) -> None:
    rng = np.random.default_rng([2028, k])
    drawn = rigs.random_rig(rng, 1 + k % 3, forces=k % 2, lines=12, worst=100)
    channels = tuple(replace(channel, noise=0.01) for channel in calibrated(rigs.channels(drawn), k))
    test = dwells(drawn.model, drawn.frequency_hz.tolist(), 48)
    name = AUTO if method is None else method
    scenario = Scenario({"rig": k}, drawn.model, drawn.theta, channels, test, (name,), 1)
    studied = repeats_of(Task(scenario, 0, 1, seed=k))[name]
    spectrum = scenario.drawn(generator(k, scenario.key, 0), 1)
    alone = identify(Rig(drawn.model, channels), replace(spectrum, amplitudes=spectrum.amplitudes[0]), method)
    m = len(drawn.model.unknowns)
    assert np.all(
        np.abs(studied.values[0] - alone.values[:m]) <= SAME * alone.sd[:m] + 1e-12 * np.abs(alone.values[:m])
    )


@pytest.mark.slow
def test_rigs_of_a_fleet_and_draws_of_a_study_are_searched_as_one_rig_is(tmp_path: Path) -> None:
    """Five masses in 20 % noise, where some descents from one start end nowhere, or in another minimum."""
    drawn = rigs.random_rig(np.random.default_rng(2), 5, lines=12, worst=100)
    channels = with_relative_noise(drawn.model, rigs.channels(drawn), 0.2)
    rig = Rig(drawn.model, channels)
    scenario = Scenario(
        {}, drawn.model, drawn.theta, channels, dwells(drawn.model, drawn.frequency_hz, 10), (AUTO, "oiv"), 8
    )
    studied = repeats_of(Task(scenario, 0, 8, seed=0))
    spectrum = scenario.drawn(generator(0, scenario.key, 0), 8)
    paths = []
    for k, amplitudes in enumerate(spectrum.amplitudes):
        one = replace(spectrum, amplitudes=amplitudes)
        alone = identify(rig, one)
        assert studied[AUTO].values[k] == pytest.approx(alone.values, rel=1e-9), k
        paths.append(str(tmp_path / f"rig{k}.csv"))
        write_amplitudes(one, paths[-1])
    searched = np.any(np.abs(studied["oiv"].values / studied[AUTO].values - 1) > 0.1, axis=-1)
    assert 0 < np.sum(searched) < 8
    for treatment, wanted in ((Treatment(), AUTO), (Treatment("oiv"), "oiv")):
        fleet = run_fleet(rig, of_files(paths), None, treatment)
        ended = studied[wanted].converged  # what does not come to an end is where rounding leaves it
        assert np.array_equal(fleet.columns["status"] == "converged", ended)
        for j, name in enumerate(fleet.names):
            values = studied[wanted].values[ended, j]
            assert fleet.columns[f"{name}:value"][ended] == pytest.approx(values, rel=1e-6), name


BENT = one_mass(
    "f",
    "value = 1",
    "guess = 900",
    "guess = 2",
    {"x": "noise = 1e-5", "f": ""},
    k3='law = "cubic", guess = 3e6',
)


def test_a_record_of_a_nonlinear_rig_gives_one_estimate_and_one_verdict(dashpot: Command) -> None:
    Path("rig.toml").write_text(BENT, encoding="utf-8")
    time = np.arange(120) / 100
    force = 20 * np.sin(2 * np.pi * (2 + 0.8 * time) * time)
    rows = np.column_stack([time, force])
    np.savetxt("drive.csv", rows, fmt="%.8g", delimiter=",", header="time_s,f", comments="")
    assert dashpot("simulate rig.toml --input drive.csv --out data.csv --set k=1000,c=2,k3=3e6 -q").code == 0
    assert dashpot("identify rig.toml data.csv --json out.json -q").code == 0
    command, python = Estimate.load("out.json"), read_rig("rig.toml").identify("data.csv")
    np.testing.assert_allclose(python.values, command.values, atol=SAME * command.sd.min(), rtol=1e-12)
    assert python.assessment is not None
    assert command.assessment is not None
    assert python.assessment.verdict == command.assessment.verdict
    assert abs(python["k3"].value - 3e6) < 5 * python["k3"].sd


def test_where_there_is_no_answer_the_likely_causes_are_the_same(
    dashpot: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python once left the diagnosis out."""
    rng = np.random.default_rng(5)
    drawn = rigs.random_rig(rng, 2, forces=1, lines=12, worst=100)
    rig = Rig(drawn.model, rigs.channels(drawn))
    Path("rig.toml").write_text(write_rig(rig), encoding="utf-8")
    write_records(
        list(rigs.records(drawn, rig.channels, rng, samples=96, periods=6, relative=0.02)), "data.csv"
    )

    def lost(*_: object, **__: object) -> None:
        raise ConvergenceError("no end", cure="give a guess")

    finding = Finding("sign", ("x1",), "x1 is turned", "turn it", None)
    monkeypatch.setattr(api, "identify_with_noise", lost)
    monkeypatch.setattr(api, "diagnosis", lambda *_, **__: (finding,))
    told = dashpot("identify rig.toml data.csv -q")
    assert told.code == 3
    with pytest.raises(ConvergenceError, match="x1 is turned") as refused:
        read_rig("rig.toml").identify("data.csv")
    assert [f"dashpot: {line}" for line in str(refused.value).splitlines()] == told.err
    assert refused.value.causes == (finding,)


def test_an_error_without_known_causes_is_raised_as_it_is(
    dashpot: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Raised from itself, it had no end for whoever looked behind it."""
    refused = ConvergenceError("no end", cure="give a guess")

    def lost(*_: object, **__: object) -> None:
        raise refused

    monkeypatch.setattr(api, "identify_with_noise", lost)
    monkeypatch.setattr(api, "diagnosis", lambda *_, **__: ())
    Path("rig.toml").write_text(TWO_MASSES, encoding="utf-8")
    Path("data.csv").write_text(
        "frequency_hz,x1_re,x1_im,x2_re,x2_im,u_re,u_im\n"
        + "".join(f"{hz},1,{hz},2,{hz},1,0\n" for hz in range(1, 9))
    )
    told = dashpot("identify rig.toml data.csv -q")
    assert (told.code, told.err) == (3, ["dashpot: no end; give a guess"])
    assert refused.__cause__ is None


DECISIONS = {
    "estimate/identify.py": {"estimation_plan"},
    "likelihood/settling.py": {"settling_test"},
    "likelihood/table_noise.py": {"with_residual_noise"},
    "check/identifiability.py": {"structure", "determines"},
}


@contextmanager
def counted() -> Iterator[Counter[str]]:
    """How often each decision is taken."""
    calls: Counter[str] = Counter()

    def note(frame: FrameType, event: str, argument: object) -> None:
        if event == "call":
            place = "/".join(Path(frame.f_code.co_filename).parts[-2:])
            if frame.f_code.co_name in DECISIONS.get(place, ()):
                calls[frame.f_code.co_name] += 1

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        yield calls
    finally:
        sys.setprofile(before)


TABLE = "--frequencies 1:15/8log --amplitude u=0.01 --table"
SHORT = "--frequencies 1:15/8log --amplitude u=0.01 --periods 1.5"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sent", "tests"),
    [("--frequencies 1:15/8log --amplitude u=0.01", 0), (TABLE, 0), (SHORT, 1)],
    ids=["dwells", "table", "short dwells"],
)
def test_no_decision_is_taken_twice_from_the_command_to_the_numbers(
    sent: str, tests: int, dashpot: Command, rig: Path
) -> None:
    """Whether the rig can be identified is asked before data are read, and of their lines: once each."""
    made = dashpot(f"simulate rig.toml --out data.csv {sent} {SET}")
    assert made.code == 0, made.err
    determines.cache_clear()  # which remembers the rig
    with counted() as calls:
        ran = dashpot("identify rig.toml data.csv --json estimate.json --quiet")
    assert ran.code == 0, ran.err
    wanted = {"estimation_plan": 1, "with_residual_noise": 1, "determines": 2}
    assert calls == Counter(wanted | ({"settling_test": tests} if tests else {}))
