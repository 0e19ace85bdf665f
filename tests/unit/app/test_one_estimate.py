"""One estimate of one set of data, whoever is asked for it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dashpot import identify, read_rig
from dashpot.channel import Channel
from dashpot.data.readers import write_records
from dashpot.model.rigfile import Rig, write_rig
from dashpot.study.montecarlo import Task, estimates, generator
from dashpot.study.scenario import Scenario
from dashpot.study.simulate import dwells
from tests import rigs
from tests.unit.app.conftest import Command

SAME = 1e-9  # of a standard deviation


def calibrated(channels: tuple[Channel, ...], k: int) -> tuple[Channel, ...]:
    """Of every third rig none, else the first channel of known gain, or of one that is to be found."""
    first = replace(channels[0], gain=(1.0, 1.1, None)[k % 3])
    return (first, *channels[1:])


@pytest.mark.parametrize("k", range(10))
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
    assert told.code in (0, 1), told.err
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


@pytest.mark.parametrize("k", range(10))
def test_a_draw_of_a_study_is_identified_as_data_are(k: int) -> None:
    rng = np.random.default_rng([2028, k])
    drawn = rigs.random_rig(rng, 1 + k % 3, forces=k % 2, lines=12, worst=100)
    channels = tuple(replace(channel, noise=0.01) for channel in calibrated(rigs.channels(drawn), k))
    test = dwells(drawn.model, drawn.frequency_hz.tolist(), 48)
    scenario = Scenario({"rig": k}, drawn.model, drawn.theta, channels, test, ("ml",), 1)
    [(_, studied)] = estimates(Task(scenario, 0, 1, seed=k))
    spectrum = scenario.drawn(generator(k, scenario.key, 0), 1)
    alone = identify(Rig(drawn.model, channels), replace(spectrum, amplitudes=spectrum.amplitudes[0]), "ml")
    assert np.all(np.abs(studied.values[0] - alone.values) <= SAME * alone.sd + 1e-12 * np.abs(alone.values))
