"""amplitudes.csv from the raw recordings:  python make_amplitudes.py FOLDER [OUT.csv]

FOLDER holds the files flexible_3_story__sine_1.0__ground.csv.gz …, one for each drive frequency and sensor.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.special import fdtrc

from dashpot.channel import Channel
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.readers import write_amplitudes
from dashpot.data.readers.manifest import FilesEntry, read_group, resolved
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum, concatenate
from dashpot.errors import DashpotError
from dashpot.model.rigfile import read_rig

HERE = Path(__file__).parent
NOMINAL = ("1.0", "1.5", "2.0")  # Hz, as in the names of the files
SENSORS = {"base": "ground", "x1": "floor1", "x2": "floor2", "x3": "floor3"}
HIGHEST = 20.0  # Hz
SIGNIFICANT = 0.01
SOURCE = """\
# Amplitudes of a three-storey model frame on a shake table, x(t) = Re(X exp(j w t)), accelerations in m/s^2.
# Derived by make_amplitudes.py from the recordings "Flexible vs. Stiff" of the mini shake table in
# github.com/chrystalchern/mdof, notebooks/uploads/mini_shake_table, commit 4f0e831cae79a1c021bd4081e9d952c0f6f6e3b4
# (BSD-2-Clause), runs flexible_3_story, sine 1.0, 1.5 and 2.0 Hz.  Settled part, odd harmonics up to 20 Hz.
"""


def records(folder: Path, channels: tuple[Channel, ...]) -> list[Record]:
    """One record for each drive frequency."""
    found = []
    for number, nominal in enumerate(NOMINAL):
        sensors = {sensor: {channel: "Acc_X"} for channel, sensor in SENSORS.items()}
        name = f"flexible_3_story__sine_{nominal}__{{sensor}}.csv.gz"
        files = FilesEntry(name=name, sensors=sensors, frequency_hz=float(nominal))
        for group in resolved(files, folder, str(folder), number):
            interpreted = read_group(group, None, (), channels)
            print(*interpreted.notes, sep="\n", file=sys.stderr)
            found += interpreted.records
    return found


def amplitudes(record: Record) -> Spectrum:
    """The odd harmonics below HIGHEST that are there in every channel beyond doubt; all others are solved for too.

    The test: |X|² / V is F(2, dof) where there is no signal, V being estimated from the lines beside the harmonic.
    """
    assert record.frequency_hz is not None
    half_rate = (len(record.time) - 1) / (record.time[-1] - record.time[0]) / 2
    every = range(1, int(0.95 * half_rate / record.frequency_hz))
    lines = spectrum([record], orders=every, noise="blocks", settle=True, refine=True)
    strength = np.abs(lines.amplitudes) ** 2 / np.diagonal(lines.covariance, axis1=-2, axis2=-1).real
    there = np.all(fdtrc(2, lines.dof[:, None], strength) < SIGNIFICANT / lines.amplitudes.size, axis=-1)
    odd = np.array(every) % 2 == 1
    chosen = odd & there & (lines.frequency_hz < HIGHEST)
    print(*lines.notes, sep="\n", file=sys.stderr)
    return lines.select(np.flatnonzero(chosen))


def table(folder: Path) -> Spectrum:
    """All lines of the three runs."""
    channels = read_rig(HERE / "rig.toml").channels
    return concatenate([amplitudes(record) for record in records(folder, channels)])


def main(folder: str, out: str = str(HERE / "amplitudes.csv")) -> None:
    """Write the table with its source on top."""
    write_amplitudes(table(Path(folder)), out)
    Path(out).write_text(SOURCE + Path(out).read_text(encoding="utf-8"), encoding="utf-8")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except (DashpotError, TypeError) as error:
        sys.exit(str(error) if isinstance(error, DashpotError) else __doc__)
