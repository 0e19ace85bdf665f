"""identify from a file of measured modes."""

from dataclasses import replace
from pathlib import Path

import pytest

from dashpot.data.readers.modes import read_modes
from dashpot.errors import UsageError
from dashpot.estimate.modal import identify_modal
from dashpot.estimate.result import Estimate
from dashpot.export.formats import export_rig
from dashpot.model.rigfile import read_rig
from dashpot.present.identification import moved_figure
from tests.unit.app.conftest import Command
from tests.unit.export.exported import TWO_MASSES, two_masses


@pytest.mark.slow
def test_a_rig_is_identified_from_its_own_modes(
    dashpot: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rounded to six digits, modes give the parameters back to 1e-3; the command gives the same estimate."""
    monkeypatch.chdir(tmp_path)
    rig = two_masses()
    export_rig(rig, "modes.uff")
    Path("rig.toml").write_text(TWO_MASSES)
    estimate = identify_modal(rig.model, read_modes("modes.uff", rig.model.coordinates, rig.channels))
    assert estimate.values == pytest.approx(rig.theta, rel=1e-3)
    done = dashpot("identify", "rig.toml", "modes.uff", "--json", "e.json")
    assert done.code == 0
    assert "standard deviations: assumed are 1 % of frequencies" in done.err[0]
    for same in (Estimate.load("e.json"), read_rig("rig.toml").identify("modes.uff")):
        assert same.values == pytest.approx(estimate.values, rel=1e-9)
    assert Estimate.load("e.json").assessment is not None
    done = dashpot("identify", "rig.toml", "modes.uff", "--report", "r.html", "-q")
    assert (done.code, done.out) == (0, "")
    page = Path("r.html").read_text(encoding="utf-8")
    assert page.index("The model fits") < page.index("<h2>Modes")
    assert "Share of the information" not in page  # of what is not shown, nothing is explained
    refused = dashpot("identify", "rig.toml", "modes.uff", "--method", "ml")
    assert (refused.code, refused.err) == (
        2, ["dashpot: modes.uff contains modes, to which --method does not apply; leave --method out"],
    )  # fmt: skip


def test_a_figure_of_what_has_moved(
    dashpot: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the guesses of the rig file; without any there is nothing to draw."""
    monkeypatch.chdir(tmp_path)
    export_rig(two_masses(), "modes.uff")
    Path("rig.toml").write_text(TWO_MASSES)
    done = dashpot("identify", "rig.toml", "modes.uff", "--figure", "moved.svg", "-q")
    assert (done.code, done.out) == (0, "")
    assert "<svg" in Path("moved.svg").read_text(encoding="utf-8")
    rig = read_rig("rig.toml")
    bare = tuple(replace(one, guess=None, sd=None) for one in rig.model.elements)
    with pytest.raises(UsageError, match="no change can be drawn"):
        moved_figure(replace(rig.model, elements=bare), rig.identify("modes.uff"))
