"""Spectra, records and rigs as text and HTML."""

import re

from dashpot.present.data import notebook_document, spectrum_document
from dashpot.present.document import html_of, printed
from tests.unit.present.conftest import RIG, measured


def test_a_spectrum_is_summed_up() -> None:
    text = printed(spectrum_document(measured(), ["m", "m", "m"], "t.csv"))
    assert "t.csv: 10 frequencies from 1.00 to 20.0 Hz" in text
    assert re.search(r"^x1 .* m", text, re.MULTILINE)
    assert "estimated from what was given" in text


def test_html_names_channels_and_elements_and_is_escaped() -> None:
    html = html_of(notebook_document(measured()))
    assert all(f">{channel.name}<" in html for channel in RIG.channels)
    html = html_of(notebook_document(RIG))
    assert "<script" not in html
    assert all(f">{element.name}<" in html for element in RIG.model.elements)
    assert "unknown" in html
