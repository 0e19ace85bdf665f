"""amplitudes.csv from the raw recording:  python make_amplitudes.py MultisineTypeA.mat [OUT.csv]"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from dashpot.data.periods import average_periods
from dashpot.data.readers import write_amplitudes
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError
from dashpot.model.rigfile import read_rig

HERE = Path(__file__).parent
COLUMNS = {"current": "iq_adx", "theta_m": "theta_mx", "theta_l": "theta_my"}  # A, rad, rad
LINES = range(11, 251)  # Hz, the excited ones
PERIOD = 1.0  # s
SOURCE = """\
# Amplitudes of a two-inertia motor bench under a multisine torque, x(t) = Re(X exp(j w t)); A, rad, rad.
# Derived by make_amplitudes.py from Examples/private/MultisineTypeA.mat of github.com/WataruOhnishi/FdiTools, commit
# 760b945947491d93917557a145e8637fa209c7d8 (MIT); experiment by Thomas Beauduin.  Mean of 19 periods of 1 s.
"""


def record(path: Path) -> Record:
    """The three channels; the sampling times are in µs."""
    content = loadmat(path, variable_names=["time", *COLUMNS.values()])
    channels = read_rig(HERE / "rig.toml").channels
    values = np.stack([content[COLUMNS[channel.name]].ravel() for channel in channels], axis=-1)
    return Record(channels, content["time"].ravel() * 1e-6, values, source=path.name)


def table(path: Path) -> Spectrum:
    """Mean of all periods but the first, in which the bench comes to rest about where it then stays."""
    return average_periods(record(path), PERIOD, LINES, skip=1)


def main(path: str, out: str = str(HERE / "amplitudes.csv")) -> None:
    """Write the table with its source on top."""
    write_amplitudes(table(Path(path)), out)
    Path(out).write_text(SOURCE + Path(out).read_text(encoding="utf-8"), encoding="utf-8")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except (DashpotError, OSError, TypeError) as error:
        sys.exit(__doc__ if isinstance(error, TypeError) else str(error))
