"""Which lines share a dwell or a whole record, through selection, joining, merging and tables."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.data.readers import read, write_amplitudes
from dashpot.data.spectrum import SettledDwell, Spectrum, WholeRecord, concatenate, merge_repeats
from dashpot.errors import DataError

RECORD = WholeRecord(10.0, 1000)
DWELL = SettledDwell(2.0)


def spectrum(frequency_hz: list[float], stretch: list[int], stretches: tuple[object, ...]) -> Spectrum:
    lines = len(frequency_hz)
    rng = np.random.default_rng(3)
    X = rng.normal(size=(lines, 2)) + 1j * rng.normal(size=(lines, 2))
    V = np.broadcast_to(1e-3 * np.eye(2), (lines, 2, 2))
    channels = (Channel("u", {"u": 1.0}), Channel("x", {"x": 1.0}))
    return Spectrum(
        channels, frequency_hz, X, V, np.full(lines, 100), np.full(lines, 96.0), ("white",) * lines,
        np.zeros(lines, dtype=int), stretch=np.array(stretch), stretches=stretches,  # type: ignore[arg-type]
    )  # fmt: skip


def mixed() -> Spectrum:
    return spectrum(
        [1.0, 2.0, 4.0, 0.1, 0.2, 0.1], [0, 1, 1, 2, 2, 3], (SettledDwell(), DWELL, RECORD, RECORD)
    )


def test_responses_per_unit_of_an_input_stay_apart_from_dwells_and_share_a_stretch() -> None:
    responses = spectrum([1.0, 2.0], [], (SettledDwell(per_unit=True),))
    both = concatenate([responses, responses, mixed()])
    assert both.stretches == (SettledDwell(per_unit=True), *mixed().stretches)
    assert merge_repeats(both).stretches[0] == SettledDwell(per_unit=True)


def test_lines_stand_for_themselves_unless_something_else_is_said() -> None:
    plain = spectrum([1.0, 2.0], [], (SettledDwell(),))
    assert plain.stretch.tolist() == [0, 0]
    assert plain.records == ()
    assert concatenate([plain, plain]).stretches == (SettledDwell(),)


def test_orders_of_a_dwell() -> None:
    assert DWELL.orders(np.array([2.0, 6.0])).tolist() == [1, 3]
    assert SettledDwell().orders(np.array([2.0, 6.0])).tolist() == [1, 1]


def test_selection_renumbers() -> None:
    few = mixed().select([4, 1])
    assert [few.stretches[k] for k in few.stretch] == [RECORD, DWELL]
    assert len(few.stretches) == 2


def test_joined_records_stay_apart() -> None:
    both = concatenate([mixed(), mixed()])
    assert len(both.stretches) == 7  # plain lines are one stretch, dwells and records are not
    assert len(both.records) == 4
    assert both.stretch.tolist() == [0, 1, 1, 2, 2, 3, 0, 4, 4, 5, 5, 6]


def test_merging_leaves_records_alone() -> None:
    twice = concatenate([mixed(), mixed()])
    merged = merge_repeats(twice)
    # 1 Hz alone is one line; the two dwells of 2 Hz are repeats; no line of a record is averaged with another one's.
    assert merged.lines == 3 + 6
    kinds = [merged.stretches[k] for k in merged.stretch]
    assert kinds == [SettledDwell(), DWELL, DWELL, *[RECORD] * 6]
    assert len({int(k) for k in merged.stretch[3:]}) == 4


def test_a_table_carries_them(tmp_path: Path) -> None:
    responses = spectrum([1.0, 2.0], [], (SettledDwell(per_unit=True),))
    written = concatenate([mixed(), responses])
    write_amplitudes(written, tmp_path / "lines.csv")
    lines = read(tmp_path / "lines.csv", written.channels).amplitudes
    assert lines is not None
    assert lines.stretches == written.stretches
    assert lines.stretch.tolist() == written.stretch.tolist()


def test_a_table_that_contradicts_itself(tmp_path: Path) -> None:
    path = tmp_path / "lines.csv"
    write_amplitudes(mixed(), path)
    text = path.read_text().splitlines()
    text[4] = text[4].replace("10.0", "11.0")
    path.write_text("\n".join(text) + "\n")
    with pytest.raises(DataError, match=r"record 2 is described"):
        read(path, mixed().channels)


def test_refusals() -> None:
    with pytest.raises(DataError, match="a line belongs"):
        replace(mixed(), stretch=np.array([0, 1, 1, 2, 2, 4]))
    with pytest.raises(DataError, match="must be positive"):
        WholeRecord(0.0, 10)
