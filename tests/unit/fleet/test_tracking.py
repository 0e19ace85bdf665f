"""Tracking: a stiffness that falls is found at its time and size, also by windows of a program and by the command."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow.parquet as parquet
import pytest

import dashpot
from dashpot.arrays import Real
from dashpot.data.record import Record
from dashpot.errors import DataError, UsageError
from tests.two_masses import one_mass
from tests.unit.app.conftest import Command
from tests.unit.app.conftest import dashpot as command

__all__ = ["command"]

CHANNELS = {"a": 'of = "x", quantity = "acceleration", unit = "m/s²", noise = 0.05', "f": 'unit = "N"'}
RIG = 'name = "One mass"\n' + one_mass("f", "value = 2", of=CHANNELS)
RATE = 50.0


def segment(k: float, c: float, begin: float, seconds: float, seed: int) -> Record:
    """A record of the rig under a random force, from rest."""
    time = begin + np.arange(round(seconds * RATE)) / RATE
    rng = np.random.default_rng(seed)
    frequency = np.arange(0.5, 12.0, 1 / seconds)
    phase = 2 * np.pi * (frequency[:, None] * (time - begin) + rng.uniform(size=(len(frequency), 1)))
    force = np.sum(np.cos(phase), axis=0)
    rig = dashpot.parse_rig(RIG)
    (record,) = dashpot.simulate(rig, {"k": k, "c": c}, {"time_s": time, "f": force}, seed=seed)
    return record


@cache
def record(drop: float = 0.05, half: float = 60.0) -> dict[str, Real]:
    """Twice `half` seconds as columns; in the middle k = 2000 N/m falls by that share."""
    parts = [segment(2000.0, 4.0, 0.0, half, 1), segment(2000.0 * (1 - drop), 4.0, half, half, 2)]
    values = np.concatenate([part.values for part in parts])
    time = np.concatenate([part.time for part in parts])
    names = [channel.name for channel in parts[0].channels]
    return {"time_s": time, **{name: values[:, i] for i, name in enumerate(names)}}


@pytest.mark.slow
def test_a_fall_is_found_at_its_time_and_size() -> None:
    rig = dashpot.parse_rig(RIG)
    track = dashpot.track(rig, record(), "20 s")
    (change,) = track.changes
    assert (change.name, change.kind) == ("k", "abrupt")
    assert change.time95_s[0] <= 60.0 <= change.time95_s[1]
    assert change.time95_s[1] - change.time95_s[0] <= 20.0
    assert abs(change.size + 100.0) < 3 * change.sd
    assert change.relative == pytest.approx(-0.05, abs=0.005)
    true = np.where(np.arange(6) < 3, 2000.0, 1900.0)
    assert np.all(np.abs(track.values[:, 0] - true) < 4 * track.sd[:, 0])
    assert np.all(track.sd < 1.05 * track.alone_sd)
    size, sd = re.search(r"k fell by (\S+) ± (\S+) %", str(track)).groups()
    assert len(size.partition(".")[2]) == len(sd.partition(".")[2])
    # Window by window, as a program gets them
    tracker = dashpot.Tracker(rig)
    for part in range(6):
        rows = slice(part * 1000, (part + 1) * 1000)
        assert tracker.add({name: column[rows] for name, column in record().items()})
    again = tracker.track()
    assert again.values == pytest.approx(track.values)
    with pytest.raises(DataError, match="before the last"):
        tracker.add({name: column[:1000] for name, column in record().items()})


def test_given_speeds_and_what_cannot_be() -> None:
    rig = dashpot.parse_rig(RIG)
    track = dashpot.track(rig, record(), 30.0, speed={"k": 0.5})
    assert track.given
    assert track.speed[1] == 0.0
    for options, words in (
        ({"speed": {"q": 0.1}}, "no unknown q"),
        ({"speed": -1.0}, "speed of"),
        ({"false_alarms": 0.9}, "false alarms"),
        ({"window": -2.0}, "window of -2"),
        ({"window": 0.1}, "too short"),
        ({"window": 1000.0}, "no window"),
    ):
        with pytest.raises((UsageError, DataError), match=words):
            dashpot.track(rig, record(), **{"window": 40.0, **options})  # type: ignore[arg-type]


@pytest.mark.slow
def test_the_command_writes_and_follows(command: Command, tmp_path: Path) -> None:
    columns = record()
    Path("rig.toml").write_text(RIG, encoding="utf-8")
    head = ",".join(columns)
    np.savetxt("long.csv", np.column_stack(list(columns.values())), "%.9g", ",", header=head, comments="")
    out = "--json t.json --out t.parquet --figure t.svg"
    done = command(f"track rig.toml long.csv --window 20s {out}")
    assert done.code == 0, done.err
    assert done.out.startswith("k fell by")
    content = json.loads(Path("t.json").read_text(encoding="utf-8"))
    (change,) = content["changes"]
    assert change["parameter"] == "k"
    assert len(content["parameters"]["c"]["value"]) == len(content["windows"]["start_s"]) == 6
    assert parquet.read_table("t.parquet").column_names[:4] == ["start_s", "end_s", "k", "k_sd"]
    assert "<svg" in Path("t.svg").read_text(encoding="utf-8")
    followed = command("track rig.toml long.csv --window 40s --follow 0.5s --json f.json")
    assert followed.code == 0, followed.err
    for words in (
        "--window 0.1s",
        "--window 0s",
        "--window 500s",
        "--window 20s --speed q=1%",
        "--window few",
    ):
        done = command(f"track rig.toml long.csv {words}")
        assert done.code == 2, words
        assert len(done.err) == 1
