"""Predicts records that were not used, from their input and the state at their start.

python validate.py RIG ESTIMATE.json RECORD.csv…
"""

from __future__ import annotations

import sys

from dashpot import Estimate
from dashpot.data.readers import read
from dashpot.estimate.nonlinear.record_prediction import predict_record
from dashpot.model.rigfile import read_rig


def main(rig: str, estimate: str, *records: str) -> None:
    """Print the rms error of each record and channel, and its share of the motion."""
    described, found = read_rig(rig), Estimate.load(estimate)
    for path in records:
        for record in read([path], described.channels).records:
            prediction = predict_record(described.model, found, record)
            for name, rms, share in zip(prediction.names, prediction.rms, prediction.relative, strict=True):
                print(f"{path}: {name} {1e3 * rms:.3f} mV rms, {100 * share:.2f} % of the motion")


if __name__ == "__main__":
    main(*sys.argv[1:])
