"""Spectra, records and rigs as text and HTML."""

import io
import re

from rich.console import Console

from dashpot.present.tables.spectrum import rig_html, show_spectrum, spectrum_html
from tests.unit.present.conftest import RIG, measured


def test_a_spectrum_is_summed_up() -> None:
    out = io.StringIO()
    show_spectrum(Console(file=out, width=80), measured(), ["m", "m", "m"], "t.csv")
    text = out.getvalue()
    assert "t.csv: 10 frequencies from 1.00 to 20.0 Hz" in text
    assert re.search(r"^x1 .* m", text, re.MULTILINE)
    assert "estimated from what was given" in text


def test_html_names_channels_and_elements_and_is_escaped() -> None:
    html = spectrum_html(measured())
    assert all(f">{channel.name}<" in html for channel in RIG.channels)
    html = rig_html(RIG)
    assert "<script" not in html
    assert all(f">{element.name}<" in html for element in RIG.model.elements)
    assert "unknown" in html
