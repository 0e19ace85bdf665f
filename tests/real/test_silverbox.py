"""The Silverbox of ../shared/data: five parameters from a part of the multisines, and what they predict."""

import gzip

import numpy as np
import pytest

from dashpot.data.record import Record
from dashpot.estimate.nonlinear.whole_record import fit_records, followed_record
from dashpot.model.rigfile import read_rig
from tests.real.recordings import EXAMPLES, RAW, needs_recordings

DATA = RAW / "duffing_silverbox" / "SNLS80mV.csv.gz"
pytestmark = needs_recordings
STEP = 2**14 / 1e7


@pytest.fixture(scope="module")
def samples():
    with gzip.open(DATA, "rt") as file:
        raw = np.genfromtxt(file, delimiter=",", skip_header=1, usecols=(0, 1))
    return raw[np.all(np.isfinite(raw), axis=1)]


def part(rig, samples, first, last):
    return Record(rig.channels, STEP * np.arange(last - first), samples[first:last])


@pytest.mark.long
def test_five_parameters_predict_what_was_not_used(samples):
    rig = read_rig(EXAMPLES / "12_duffing" / "rig.toml")
    estimate = fit_records(rig.model, [part(rig, samples, 45_000, 50_000)]).estimate()
    assert bool(estimate.converged)
    for name, low, high in (
        ("m", 5.36e-6, 5.39e-6),
        ("k", 0.985, 0.995),
        ("k3", 3.88, 3.97),
        ("k2", -0.045, -0.025),
    ):
        assert low < estimate[name].value < high
    assert -0.0056 < estimate["u.offset"].value < -0.0053
    arrow = followed_record(rig.model, estimate, part(rig, samples, 20_000, 40_500)).compared()
    assert arrow.rms[0] < 0.5e-3
    rest = followed_record(rig.model, estimate, part(rig, samples, 90_000, 95_000)).compared()
    assert rest.rms[0] < 0.33e-3
