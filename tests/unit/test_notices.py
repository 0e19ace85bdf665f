"""Notices: a sentence for readers and a code for programs."""

import json
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from dashpot import Channel, Element, Estimate, Input, Kind, Model, Notice, OptimalIV, Spectrum, identify
from dashpot.model.dynamics import response


def test_a_notice_reads_as_its_text() -> None:
    notice = Notice("at_bound", "c1 is at its bound", ["c1"])  # type: ignore[arg-type]
    assert f"{notice}" == "c1 is at its bound"
    assert notice.of == ("c1",)
    with pytest.raises(FrozenInstanceError):
        notice.code = "other"  # type: ignore[misc]


@pytest.mark.parametrize(("written", "read"), [
    ("x is 2.3e+02 standard deviations off", "x is 230 standard deviations off"),
    ("k2 came out negative (-1.776e+05 N/m)", "k2 came out negative (-177600 N/m)"),
    ("(p = 3.4e-05), 5.4e+07 N/m", "(p = 3.4e-5), 5.4e7 N/m"),
    ("x1e+05 and 1:10/25, p < 1e-6", "x1e+05 and 1:10/25, p < 1e-6"),
])  # fmt: skip
def test_numbers_of_a_sentence_are_written_out(written: str, read: str) -> None:
    assert Notice("standing_out", written).text == read


def estimated() -> Estimate:
    """One mass; an unknown damper that is negative, unknown noise, and a note of the data."""
    elements = (
        Element("m", Kind.MASS, {"x": 1}, value=2.0),
        Element("k", Kind.SPRING, {"x": 1, "u": -1}),
        Element("c", Kind.DAMPER, {"x": 1, "u": -1}),
    )
    model = Model(("x",), (Input("u"),), elements)
    f = np.linspace(1, 9, 7)
    U = np.full((7, 1), 1e-3 + 0j)
    X = response(model, np.array([2.0, 2000.0, -3.0]), 2 * np.pi * f, U, np.zeros((7, 0), complex))
    rng = np.random.default_rng(3)
    X = X * (1 + 0.01 * (rng.standard_normal(X.shape) + 1j * rng.standard_normal(X.shape)))
    spectrum = Spectrum(
        (Channel("x", {"x": 1}), Channel("u", {"u": 1})), f, np.concatenate([X, U], axis=-1),
        np.full((7, 2, 2), np.nan), np.ones(7), np.full(7, np.inf), ("unknown",) * 7, np.zeros(7),
        notes=(Notice("clipped", "x stays at its limit", ("x",)),),
    )  # fmt: skip
    return identify(model, spectrum, OptimalIV())


def test_warnings_and_notes_keep_their_codes_in_json() -> None:
    """Sentences stay lists of strings; codes stand beside them; a file without codes loads as well."""
    estimate = estimated()
    codes = [notice.code for notice in estimate.warnings]
    assert "unknown_noise" in codes
    assert "negative" in codes
    assert estimate.warnings[codes.index("negative")].of == ("c",)
    assert estimate.notes[0].of == ("x",)
    content = json.loads(estimate.to_json())
    assert content["warnings"] == [notice.text for notice in estimate.warnings]
    assert content["codes"] == codes
    assert content["notes"] == [notice.text for notice in estimate.notes]
    assert content["notes"][0] == "x stays at its limit"
    again = Estimate.from_json(estimate.to_json())
    assert again.warnings == estimate.warnings
    assert again.notes == estimate.notes
    for key in ("codes", "concerns", "notes", "note_codes", "note_concerns"):
        del content[key]
    old = Estimate.from_json(json.dumps(content))
    assert [str(notice) for notice in old.warnings] == content["warnings"]
    assert old.notes == ()
    assert replace(estimate, notes=()).notes == ()
