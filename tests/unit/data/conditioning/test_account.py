"""The one line on the treatment of settled dwells says what was done to them."""

import numpy as np

from dashpot.data.conditioning.lines import spectrum
from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.record import Record
from tests.unit.data.conditioning.signals import X1, U, wave


def account(settings: Conditioning | None = None, off: float = 1.0) -> str:
    """The line on five dwells of 400 samples whose stated frequencies are `off` times the true."""
    rng = np.random.default_rng(1)
    dwells = []
    for f in (4.0, 5.0, 6.0, 7.0, 8.0):
        t = np.arange(400) / 200
        values = wave(t, f, (1.0, 0.5))
        dwells.append(Record((X1, U), t, values + 0.01 * rng.normal(size=values.shape), off * f))
    notes = spectrum(dwells, settings).notes
    (line,) = (note.text for note in notes if note.code == "settled_dwells")
    return line


def test_the_line_says_how_much_is_used_and_what_was_taken_out() -> None:
    assert account() == (
        "5 dwells as steady sines: all 2000 samples used, frequency as stated, offset and slope removed"
    )
    plain = account(Conditioning(drift=0, refine="none", transients="none"))
    assert "an offset removed" in plain
    assert "nothing removed" in account(Conditioning(drift="none", transients="none"))


def test_refined_frequencies_and_discarded_samples_are_counted() -> None:
    assert "all 2000 samples used, frequency refined" in account(off=1.003)
    settled = account(Conditioning(settle=0.5))
    assert "75 % of 2000 samples used" in settled
