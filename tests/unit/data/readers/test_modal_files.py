"""Modes of universal files: which node is which coordinate, what is assumed, and the estimate they lead to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.data.readers.modes import holds_modes, modes_and_notes, read_modes
from dashpot.data.readers.uff import FRF, NodalFunction, NodalMode, NodePoint
from dashpot.data.readers.uff_writer import write_universal_file
from dashpot.errors import DataError


def two_modes(path: Path, ids: tuple[str, ...] = ()) -> None:
    """Nodes 7 in Y and 9 in Z; conjugates are left out."""
    shapes = np.zeros((2, 3), dtype=complex)
    shapes[0, 1], shapes[1, 2] = 1.0, 0.5 - 0.1j
    rates = (-2 + 20j, -2 - 20j, -5 + 60j)
    write_universal_file(path, (), [NodalMode(rate, (7, 9), shapes * rate.imag, ids) for rate in rates])


def test_nodes_in_order_by_channels_and_by_name(tmp_path: Path) -> None:
    path = tmp_path / "modes.uff"
    two_modes(path)
    data, notes = modes_and_notes(path, ("a", "b"))
    assert data.points == ("a", "b")
    assert data.frequency_hz == pytest.approx(np.abs([-2 + 20j, -5 + 60j]) / (2 * np.pi), rel=1e-5)
    assert data.damping_ratio == pytest.approx([2 / abs(-2 + 20j), 5 / abs(-5 + 60j)], rel=1e-5)
    assert data.shapes[0] == pytest.approx([20, 10 - 2j], rel=1e-5)
    assert np.sqrt(data.covariance[:, 0, 0]) == pytest.approx(0.01 * data.frequency_hz)
    assert [note.code for note in notes] == ["modes_without_sd", "modes_in_order"]
    assert "7+Y = a, 9+Z = b" in str(notes[1])
    channels = (Channel("9+Z", {"a": 2.0}), Channel("7+Y", {"b": -1.0}))
    by_channel, notes = modes_and_notes(path, ("a", "b"), channels, (0.1, 0.1, 0.1))
    assert by_channel.shapes[0] == pytest.approx([5 - 1j, -20], rel=1e-5)
    assert [note.code for note in notes] == ["modes_without_sd"]
    assert read_modes(path, ("9+Z",)).points == ("9+Z",)
    assert read_modes(path, ("7", "9")).points == ("7", "9")
    two_modes(path, ("", "", "7 = b, 9 = a"))
    assert read_modes(path, ("a", "b")).shapes[0] == pytest.approx([10 - 2j, 20], rel=1e-5)


def test_what_has_no_node_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "modes.uff"
    two_modes(path)
    with pytest.raises(DataError, match=r"no node is a coordinate"):
        read_modes(path, ("a", "b", "c"))
    write_universal_file(path, (), [NodalMode(-1 - 5j, (1,), np.ones((1, 3)))])
    with pytest.raises(DataError, match="no oscillating mode"):
        read_modes(path, ("a",))


def test_which_files_hold_modes_alone(tmp_path: Path) -> None:
    modes, both, table, amplitudes = (tmp_path / name for name in ("m.uff", "b.uff", "m.csv", "a.csv"))
    two_modes(modes)
    response = NodalFunction(FRF, NodePoint("", 1, 1), NodePoint("", 2, 1), np.arange(3.0), np.ones(3) + 0j)
    write_universal_file(both, [response], [NodalMode(-1 + 5j, (1,), np.ones((1, 3)))])
    table.write_text("frequency_hz,frequency_sd\n3,0.1\n")
    amplitudes.write_text("frequency_hz,x_re,x_im\n3,0.1,0\n")
    assert [holds_modes(path) for path in (modes, both, table, amplitudes, tmp_path / "none.uff")] == [
        True, False, True, False, False,
    ]  # fmt: skip
