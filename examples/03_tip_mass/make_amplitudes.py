"""amplitudes.csv from the raw recordings:  python make_amplitudes.py FOLDER [OUT.csv]

FOLDER holds mass1/ and mass2/ with the files 3Hz_tmp_001.txt …, one for each drive frequency.
"""

from __future__ import annotations

import sys
from pathlib import Path

from dashpot.data.conditioning.lines import spectrum
from dashpot.data.readers import write_amplitudes
from dashpot.data.readers.manifest import FilesEntry, read_group, resolved
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError
from dashpot.model.rigfile import read_rig

HERE = Path(__file__).parent
LOWEST = 2.0  # Hz
SOURCE = """\
# Amplitudes of a cantilever with two tip masses, pushed by a shaker, x(t) = Re(X exp(j w t)); a in g and F in N as
# labelled, the gain between them is wrong.  Derived by make_amplitudes.py from the LabVIEW files of
# github.com/carlos-adir/UnB-Courses, vibracoes/Experimental/second_experiment/massa1 and massa2, commit
# a7024fdf98f3b7616fb4af4d1cd7b15ec272aec4 (GPL-3.0).  Experiment 0: 1.437 kg, 1: 0.712 kg.
"""


def records(folder: Path) -> list[Record]:
    """A record for each file above LOWEST, driven at the frequency in its name."""
    channels = read_rig(HERE / "rig.toml").channels
    found: list[Record] = []
    for number in (0, 1):
        columns = {f"a{number + 1}": "Acceleration (Trigger)", f"F{number + 1}": "Force (Trigger)"}
        files = FilesEntry(name=f"mass{number + 1}/*.txt", columns=columns)
        for group in resolved(files, folder, str(folder), number):
            found += read_group(group, None, (), channels).records
    driven = [(record.experiment, record.frequency_hz, record) for record in found]
    return [record for _, f, record in sorted(driven, key=lambda d: d[:2]) if f is not None and f > LOWEST]


def table(folder: Path) -> Spectrum:
    """The fundamental of every record."""
    return spectrum(records(folder), refine=True)


def main(folder: str, out: str = str(HERE / "amplitudes.csv")) -> None:
    """Write the table with its source on top."""
    write_amplitudes(table(Path(folder)), out)
    Path(out).write_text(SOURCE + Path(out).read_text(encoding="utf-8"), encoding="utf-8")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except (DashpotError, TypeError) as error:
        sys.exit(str(error) if isinstance(error, DashpotError) else __doc__)
