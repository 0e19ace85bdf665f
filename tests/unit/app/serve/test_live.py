"""A live test by the engine alone: a folder that fills, and a file whose last dwell is not finished."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dashpot.app.serve.engine import carry_out
from dashpot.app.serve.live import lost_samples
from dashpot.channel import Channel
from dashpot.data.conditioning.unmeasured import marked
from dashpot.data.record import Record
from tests.unit.app.conftest import Command


def dwell(lost: range = range(0), held: range = range(0), count: int = 160) -> Record:
    """Four periods of 5 Hz at 200 Hz, or more, of which some rows are lost, or hold one value."""
    time = np.arange(count) / 200
    x = np.sin(2 * np.pi * 5 * time)
    x[held] = x[held[:1]]
    kept = np.setdiff1d(np.arange(count), lost)
    return Record((Channel("x", {"x": 1}),), time[kept], x[kept, None], frequency_hz=5.0)


@pytest.mark.parametrize(
    ("record", "said"),
    [
        (dwell(), []),
        (dwell(range(40, 52)), ["12 samples missing"]),
        (dwell(range(40, 41)), ["1 sample missing"]),
        (dwell(held=range(60, 90)), ["x holds one value for 30 samples"]),
        (dwell(held=range(60, 70)), []),  # a coarse converter near a turning point
    ],
)
def test_what_a_dwell_lacks_is_said(record: Record, said: list[str]) -> None:
    found = lost_samples([record])
    assert len(found) == len(said)
    assert all(text.startswith(start) for text, start in zip(found, said, strict=True))


def test_a_held_channel_is_named_once() -> None:
    held = dwell(held=range(60, 90))
    (said,) = lost_samples([held, dwell(), held, held])
    assert "2 other dwells" in said
    # Of a long dwell conditioning itself marks these samples, and its note of them is shown.
    long = dwell(held=range(60, 90), count=800)
    assert marked([long])[1]
    assert lost_samples([long]) == []


class Stopped(BaseException):
    """As a Cancel ends the process of a live test."""


@pytest.mark.long
def test_intervals_shrink_as_a_folder_fills(dashpot: Command, rig: Path, data: Path) -> None:
    head, *rows = data.read_text(encoding="utf-8").splitlines(keepends=True)
    bench, each = rig.parent / "bench", len(rows) // 8
    for folder in (bench, rig.parent / "out"):
        folder.mkdir()
    # The fourth dwell of the first file is not finished: it does not count until it is.
    (bench / "run1.csv").write_text(head + "".join(rows[: 3 * each + each // 2]), encoding="utf-8")
    steps: list[tuple[int, float]] = []

    def tell(event: dict[str, Any]) -> None:
        found = event.get("result", {})
        assert "failed" not in event
        for step in found.get("history", ())[len(steps) :]:
            steps.append((step["samples"], max(row["share"] for row in step["rows"])))
        if len(steps) == 1:
            (bench / "run2.csv").write_text(head + "".join(rows[3 * each :]), encoding="utf-8")
        if found.get("enough"):
            raise Stopped

    call = {"call": "watch", "folder": str(rig.parent), "rig": rig.name, "out": "out", "source": "bench"}
    with pytest.raises(Stopped):
        carry_out({**call, "target": "0.1%", "options": {"rate": 200}}, tell)
    assert steps[0][0] == 3 * each
    assert steps[-1][1] <= 0.001 < steps[0][1]
