"""Samples of TDMS channels in pieces, however they stand in the file: what nptdms makes of the whole channel."""

from __future__ import annotations

import struct
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from nptdms import ChannelObject, TdmsFile, TdmsWriter

from dashpot.arrays import Real
from dashpot.data.readers import guarded
from dashpot.data.readers import tdms as tdms_blocks
from dashpot.data.readers.arrays import ArrayColumns
from dashpot.data.readers.datafile import open_file
from dashpot.data.readers.registry import reader_of
from dashpot.data.readers.tdms import UNFINISHED

DOUBLE, INTEGER = 10, 3
DESCRIBED, NEW, NUMBERS = 1 << 1, 1 << 2, 1 << 3  # contents of a segment


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tdms_blocks, "PIECE", 7)
    monkeypatch.setattr(guarded, "SMALL", 0)  # columns are asked for


def require_the_same(path: Path) -> None:
    """Each channel is what nptdms reads of it, and comes in pieces of 7 at most."""
    with TdmsFile.open(path) as content:
        wanted = {channel.name: channel[:] for group in content.groups() for channel in group.channels()}
        read: dict[str, Real] = {}
        for part in reader_of(open_file(path)).parts(open_file(path)):
            assert isinstance(part, ArrayColumns)
            for at, name in enumerate(part.header):
                read[name] = part.numbers([at])[at]
                assert max(len(piece) for piece in part.columns[at].pieces()) <= 7
    assert set(read) == set(wanted)
    for name, samples in wanted.items():
        assert np.array_equal(read[name], samples), name


def segment(contents: int, objects: bytes, raw: bytes, finished: bool = True) -> bytes:
    order = ">" if contents & tdms_blocks.BIG_ENDIAN else "<"
    length = len(objects) + len(raw) if finished else UNFINISHED
    head = b"TDSm" + struct.pack("<I", contents) + struct.pack(f"{order}IQQ", 4713, length, len(objects))
    return head + objects + raw


def described(order: str, kinds: dict[str, int], length: int, slope: float | None = None) -> bytes:
    """The objects of a segment: names and types of channels, their length, and a scale where there is one."""

    def text(word: str) -> bytes:
        return struct.pack(f"{order}I", len(word)) + word.encode()

    scale = struct.pack(f"{order}I", 0)
    if slope is not None:
        scale = struct.pack(f"{order}I", 5) + b"".join(
            [
                text("NI_Number_Of_Scales") + struct.pack(f"{order}II", 7, 1),
                text("NI_Scale[0]_Scale_Type") + struct.pack(f"{order}I", 0x20) + text("Linear"),
                text("NI_Scale[0]_Linear_Slope") + struct.pack(f"{order}Id", DOUBLE, slope),
                text("NI_Scale[0]_Linear_Y_Intercept") + struct.pack(f"{order}Id", DOUBLE, 0.5),
                text("NI_Scale[0]_Linear_Input_Source") + struct.pack(f"{order}II", 7, 0xFFFFFFFF),
            ]
        )
    return struct.pack(f"{order}I", len(kinds)) + b"".join(
        text(f"/'run'/'{name}'") + struct.pack(f"{order}IIIQ", 20, kind, 1, length) + scale
        for name, kind in kinds.items()
    )


@pytest.mark.parametrize("seed", range(4))
def test_segments_and_chunks_of_any_length(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    with TdmsWriter(str(tmp_path / "a.tdms")) as writer:
        for _ in range(3):
            lengths = rng.integers(1, 40, 2)
            for _ in range(rng.integers(1, 4)):  # chunks alike share one description
                writer.write_segment(
                    [
                        ChannelObject("g", name, (50 * rng.normal(size=length)).astype(kind))
                        for name, length, kind in zip("ab", lengths, ("f8", "i2"), strict=True)
                    ]
                )
    require_the_same(tmp_path / "a.tdms")


@pytest.mark.parametrize("slope", [None, 0.25])
@pytest.mark.parametrize("finished", [True, False])
@pytest.mark.parametrize("alternating", [0, tdms_blocks.INTERLEAVED])
@pytest.mark.parametrize("order", ["<", ">"])
def test_channels_side_by_side(
    tmp_path: Path, order: str, alternating: int, finished: bool, slope: float | None
) -> None:
    """Two and a half chunks of two channels, one after the other or sample by sample."""
    rows = np.zeros(25, dtype=[("a", f"{order}f8"), ("b", f"{order}i4")])
    rows["a"], rows["b"] = np.arange(25) / 3, np.arange(25) ** 3
    chunks = [rows[start:stop] for start, stop in pairwise((0, 10, 20, 25))]
    raw = b"".join(
        chunk.tobytes() if alternating else chunk["a"].tobytes() + chunk["b"].tobytes() for chunk in chunks
    )
    contents = DESCRIBED + NEW + NUMBERS + alternating + (tdms_blocks.BIG_ENDIAN if order == ">" else 0)
    objects = described(order, {"a": DOUBLE, "b": INTEGER}, 10, slope)
    path = tmp_path / "a.tdms"
    path.write_bytes(segment(contents, objects, raw, finished))
    require_the_same(path)
    with TdmsFile.open(path) as content:
        blocks = tdms_blocks.sample_blocks(content, "/'run'/'a'")
    assert (blocks[0].chunks, blocks[0].length) == (2, 10)


def test_dates_and_texts_are_left_to_nptdms(tmp_path: Path) -> None:
    with TdmsWriter(str(tmp_path / "a.tdms")) as writer:
        dates = np.datetime64("2026-03-01T12:00:00") + np.arange(5) * np.timedelta64(100, "ms")
        writer.write_segment([ChannelObject("g", "when", dates), ChannelObject("g", "x", np.arange(5.0))])
        writer.write_segment([ChannelObject("g", "y", np.arange(5.0)), ChannelObject("g", "note", ["a"] * 5)])
    with TdmsFile.open(tmp_path / "a.tdms") as content:
        assert tdms_blocks.sample_blocks(content, "/'g'/'when'") is None
        assert tdms_blocks.sample_blocks(content, "/'g'/'x'") is not None
        assert tdms_blocks.sample_blocks(content, "/'g'/'y'") is None
        parts = reader_of(open_file(tmp_path / "a.tdms")).parts(
            open_file(tmp_path / "a.tdms")
        )  # kept, for what is let go is closed
        part = next(parts)
        assert part.header == ("when", "x", "y")
        assert part.numbers([2])[2].tolist() == [0, 1, 2, 3, 4]


def test_what_a_channel_says_holds_for_those_of_its_length(tmp_path: Path) -> None:
    with TdmsWriter(str(tmp_path / "a.tdms")) as writer:
        driven = ChannelObject("g", "x1", np.zeros(30), {"frequency_hz": 5.0})
        writer.write_segment([driven, ChannelObject("g", "x2", np.zeros(20))])
    parts = list(reader_of(open_file(tmp_path / "a.tdms")).parts(open_file(tmp_path / "a.tdms")))
    assert [part.header for part in parts] == [("x1", "frequency_hz"), ("x2",)]
