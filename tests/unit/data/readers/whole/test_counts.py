"""Counts of a converter whose full scale the rig file says: the same parameters from every format of whole numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.data.readers import Reading, read, write_records
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.estimate.identify import identify
from dashpot.model.rigfile import Rig, parse_rig
from tests.two_masses import one_mass
from tests.unit.data.readers.column_files import TABLES, mdf, tdms, uff
from tests.unit.data.readers.famos_bytes import HEAD, channel
from tests.unit.data.readers.written import mat73

RATE, DRIVE_HZ = 128.0, (2.0, 3.0, 4.0)
MASS, DAMPING, STIFFNESS = 2.0, 6.0, 800.0
MOTION, FORCE = 0.02, 50.0  # full scales, m and N
RIG = one_mass("f", of={}) + "[channels]\n"
TWO_CONVERTERS = (
    'x = { of = "x", unit = "counts", bits = 16, full_scale = "20 mm" }\n'
    'f = { of = "f", unit = "counts", bits = 24, full_scale = "50 N" }\n'
)
SHARES = 'x = { of = "x", unit = "FS", full_scale = "20 mm" }\nf = { of = "f", unit = "FS", full_scale = "50 N" }\n'


def rig_of(channels: str) -> Rig:
    return parse_rig(RIG + channels, "rig.toml")


def dwell(drive_hz: float, samples: int = 256) -> tuple[Real, Real, Real]:
    """Time, motion and force of a settled dwell."""
    t = np.arange(samples) / RATE
    s = 2j * np.pi * drive_hz
    wave = np.exp(s * t)
    return t, (6.0 / (MASS * s**2 + DAMPING * s + STIFFNESS) * wave).real, (6.0 * wave).real


def in_counts(drive_hz: float) -> dict[str, Real]:
    _, x, f = dwell(drive_hz)
    return {
        "x": np.round(x / MOTION * 2**15).astype(np.int16),
        "f": np.round(f / FORCE * 2**23).astype(np.int32),
    }


def famos(path: Path, columns: dict[str, Real]) -> None:
    kinds = {np.dtype(np.int16): 4, np.dtype(np.int32): 6}
    blocks = [
        channel(i + 1, name, "", x.tobytes(), kinds[x.dtype], x.itemsize, 1 / RATE)
        for i, (name, x) in enumerate(columns.items())
    ]
    path.write_bytes(HEAD + b"".join(blocks))


def lvm(path: Path, columns: dict[str, Real]) -> None:
    head = "LabVIEW Measurement\t\nSeparator\tTab\nX_Columns\tNo\n***End_of_Header***\t\n\t\nChannels\t2\n"
    head += f"Delta_X\t{1 / RATE}\t{1 / RATE}"
    rows = "".join(f"\t{x}\t{f}\n" for x, f in zip(columns["x"], columns["f"], strict=True))
    path.write_text(f"{head}\n***End_of_Header***\t\t\nX_Value\tx\tf\tComment\n{rows}")


OTHERS = {
    ".tdms": lambda path, columns: tdms(path, columns, wf_increment=1 / RATE),
    ".mf4": lambda path, columns: mdf(path, columns, dwell(1.0)[0]),
    ".uff": lambda path, columns: uff(
        path, {name: x.astype(float) for name, x in columns.items()}, dwell(1.0)[0]
    ),
    ".raw": famos,
    ".lvm": lvm,
    " 7.3.mat": lambda path, columns: mat73(path, columns | {"fs": np.array([RATE])}),
}


def recorded(folder: Path, suffix: str) -> Reading:
    """The dwells in counts, as a format of whole numbers holds them."""
    for drive_hz in DRIVE_HZ:
        path, columns = folder / f"{drive_hz:g}Hz{suffix}", in_counts(drive_hz)
        if suffix in OTHERS:
            OTHERS[suffix](path, columns)
        else:
            TABLES[suffix](path, {"time_s": dwell(drive_hz)[0], **columns})
    return read(folder / f"{{frequency}}Hz{suffix}", rig_of(TWO_CONVERTERS).channels)


@pytest.mark.parametrize("suffix", [*TABLES, *OTHERS])
def test_counts_of_every_format(tmp_path: Path, suffix: str) -> None:
    records = recorded(tmp_path, suffix).records
    assert [record.frequency_hz for record in records] == list(DRIVE_HZ)
    for record in records:
        counts = in_counts(record.frequency_hz or 0.0)
        assert np.array_equal(record.values, np.stack([counts["x"], counts["f"]], axis=-1))


def test_two_converters(tmp_path: Path) -> None:
    of_counts = recorded(tmp_path, ".csv")
    in_units = rig_of('x = { of = "x" }\nf = { of = "f" }\n')
    scales = [MOTION / 2**15, FORCE / 2**23]
    records = [
        Record(in_units.channels, r.time, r.values * scales, r.frequency_hz) for r in of_counts.records
    ]
    write_records(records, tmp_path / "units.csv")
    estimate = identify(rig_of(TWO_CONVERTERS).model, of_counts.spectrum())
    same = identify(in_units.model, read(tmp_path / "units.csv", in_units.channels).spectrum())
    for name, truth in {"m": MASS, "c": DAMPING, "k": STIFFNESS}.items():
        assert estimate[name].value == pytest.approx(truth, rel=1e-3)
        assert estimate[name].value == pytest.approx(same[name].value, rel=1e-9)


def test_whole_numbers_of_sound_are_shares_of_the_full_scale(tmp_path: Path) -> None:
    from scipy.io import wavfile

    for drive_hz in DRIVE_HZ:
        _, x, f = dwell(drive_hz)
        shares = np.stack([x / MOTION, f / FORCE], axis=-1)
        wavfile.write(tmp_path / f"{drive_hz:g}Hz.wav", int(RATE), np.round(shares * 2**15).astype(np.int16))
    manifest = tmp_path / "test.toml"
    manifest.write_text(
        '[[files]]\nname = "{frequency}Hz.wav"\ncolumns = { x = "channel_1", f = "channel_2" }\n'
    )
    rig = rig_of(SHARES)
    estimate = identify(rig.model, read(manifest, rig.channels).spectrum())
    for name, truth in {"m": MASS, "c": DAMPING, "k": STIFFNESS}.items():
        assert estimate[name].value == pytest.approx(truth, rel=2e-3)
    for channels in (TWO_CONVERTERS, SHARES.replace('unit = "FS", full_scale = "20 mm"', 'unit = "mm"')):
        with pytest.raises(DataError, match=r'column x: in shares of the full scale .FS., .*unit = "FS"'):
            read(manifest, rig_of(channels).channels)


@pytest.mark.parametrize(("of_file", "of_rig"), [("V", "counts"), ("counts", "V"), ("FS", "counts")])
def test_raw_numbers_of_another_kind_are_refused(tmp_path: Path, of_file: str, of_rig: str) -> None:
    """One volt is no count, and one count no full scale, though each is one."""
    path = tmp_path / "a.csv"
    path.write_text(f"time_s,x [{of_file}],f\n0,1,1\n1,2,2\n")
    gain = "bits = 16, full_scale" if of_rig == "counts" else "gain"
    size = '"20 mm"' if of_rig == "counts" else '"1 V/mm"'
    channels = f'x = {{ of = "x", unit = "{of_rig}", {gain} = {size} }}\nf = {{ of = "f" }}\n'
    with pytest.raises(DataError, match=r"column x: in .*, the rig"):
        read(path, rig_of(channels).channels)
