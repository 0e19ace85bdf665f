"""The recordings as a new user would give them, without any option, against the examples with theirs."""

from pathlib import Path

import pytest

from dashpot.data.readers import read
from dashpot.estimate.identify import automatic, identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.model.rigfile import read_rig
from tests.real.recordings import EXAMPLES, RAW, needs_recordings

FRAME = """
[[files]]
name = "flexible_3_story__sine_{frequency}__{sensor}.csv.gz"

[files.sensors]
ground = { base = "Acc_X" }
floor1 = { x1 = "Acc_X" }
floor2 = { x2 = "Acc_X" }
floor3 = { x3 = "Acc_X" }
"""
BEAM = """
[[files]]
name = "mass1/{frequency}Hz_tmp_001.txt"
columns = { a1 = "Acceleration (Trigger)", F1 = "Force (Trigger)" }
experiment = 0

[[files]]
name = "mass2/{frequency}Hz_tmp_001.txt"
columns = { a2 = "Acceleration (Trigger)", F2 = "Force (Trigger)" }
experiment = 1
"""
BENCH = """
[[files]]
name = "MultisineTypeA.mat"
columns = { time_s = "time", current = "iq_adx", theta_m = "theta_mx", theta_l = "theta_my" }
units = { time_s = "µs" }
"""


@pytest.mark.slow
@needs_recordings
@pytest.mark.parametrize(
    ("example", "folder", "files", "codes"),
    [
        ("02_shake_table", "shake_table_3storey", FRAME, {"harmonics_driven", "clock_refined"}),
        ("03_tip_mass", "tip_mass_beam", BEAM, {"drift_by_evidence", "frequency_refined"}),
        ("04_motor_bench", "two_inertia_bench", BENCH, {"periods_averaged"}),
    ],
)
def test_no_options_give_what_the_example_gives(
    example: str, folder: str, files: str, codes: set[str], tmp_path: Path
) -> None:
    rig = read_rig(EXAMPLES / example / "rig.toml")
    manifest = tmp_path / "test.toml"
    manifest.write_text(f'folder = "{RAW / folder}"\n{files}', encoding="utf-8")
    plain = read(str(manifest), rig.channels).spectrum()
    table = EXAMPLES / example / "amplitudes.csv"
    options = read(str(table), rig.channels).spectrum()
    method = automatic(rig.model, plain)
    if isinstance(method, MaximumLikelihood):  # a part of the search, to save time
        method = MaximumLikelihood(starts=8, candidates=200, rounds=1)
    estimate, chosen = (identify(rig.model, lines, method) for lines in (plain, options))
    assert codes <= {note.code for note in plain.notes}
    assert not plain.records  # settled dwells, as they should be taken
    for name in estimate.names:
        assert abs(estimate[name].value - chosen[name].value) < 2 * chosen[name].sd, name
