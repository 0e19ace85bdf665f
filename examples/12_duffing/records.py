"""Cuts the Silverbox's measurement into records: part of the multisines to identify from, their rest and the arrow.

python records.py SNLS80mV.csv.gz FOLDER
dashpot identify rig.toml FOLDER/multisine.csv --json FOLDER/estimate.json
python validate.py rig.toml FOLDER/estimate.json FOLDER/rest.csv FOLDER/arrow.csv
"""

from __future__ import annotations

import gzip
import sys
from pathlib import Path

import numpy as np

STEP = 2**14 / 1e7  # s
PARTS = {"arrow": (0, 40_500), "multisine": (45_000, 60_000), "rest": (60_000, 131_072)}  # samples


def main(source: str, folder: str) -> None:
    """Write one CSV file for each part."""
    with gzip.open(source, "rt") as file:
        raw = np.genfromtxt(file, delimiter=",", skip_header=1, usecols=(0, 1))
    raw = raw[np.all(np.isfinite(raw), axis=1)]
    Path(folder).mkdir(parents=True, exist_ok=True)
    for name, (first, last) in PARTS.items():
        time = STEP * np.arange(last - first)
        table = np.column_stack([time, raw[first:last]])
        np.savetxt(Path(folder) / f"{name}.csv", table, "%.10g", ",", header="time_s,V1,V2", comments="")


if __name__ == "__main__":
    main(*sys.argv[1:])
