"""The reproduction of the paper for eyes: statements that follow from the numbers, a terminal, a page, figures."""

import re

import pytest

from dashpot.errors import DataError, UsageError
from dashpot.io import ledger
from dashpot.present.document import printed
from dashpot.present.reproduction import findings_in_words, reproduction_document, write_reproduction
from dashpot.reproduce.yamane1989 import reproduce


@pytest.fixture(scope="module")
def found():
    return reproduce(20, seed=5)


@pytest.mark.slow
def test_findings_say_what_the_numbers_say(found):
    text = findings_in_words(found)
    assert len(text) == 9
    column = next(c for c in found.table2 if c.title == "10 %" and c.method == "iv")
    factor = next(t for title, t in text.items() if "do not use the data fully" in title)
    assert f"{column.rms:.2f} % with iv" in factor
    assert f"{column.rms / column.bound:.2f} × the bound" in factor
    draw = text["Table 2 shows one noise draw four times"]
    assert float(re.search(r"at least (0\.\d+)", draw)[1]) > 0.99
    luck = text["The paper's draw was a lucky one"]
    assert "printed maximum 2.08 %" in luck
    for words in text.values():
        assert words[0].isupper() or words[0].isdigit()
        assert "nan" not in words


@pytest.mark.slow
def test_it_can_be_shown_and_written(found, tmp_path):
    text = printed(reproduction_document(found))
    assert "Table 2" in text
    assert "What it shows" in text
    assert max(len(line) for line in text.splitlines()) <= 80
    assert "…" not in text
    written = write_reproduction(found, tmp_path / "report.html", tmp_path / "figures")
    assert sorted(path.name for path in (tmp_path / "figures").iterdir()) == [
        "figure2.png", "figure3.png", "ranking.png", "table2.png", "table4.png",
    ]  # fmt: skip
    assert len(written) == 6
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 5
    assert "://" not in page.replace("http://www.w3.org/", "")  # needs nothing from elsewhere
    assert f"{found.findings.printed_among_draws.inside} of the paper&#39;s 70 printed errors" in page
    assert "m1 = 3 kg" in page  # drawn
    assert page.index("What next") < page.index("What it shows")
    for title in findings_in_words(found):
        assert title.replace("'", "&#39;") in page
    assert write_reproduction(found) == []
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="folder cannot be made"):
        write_reproduction(found, figures=tmp_path / "file" / "deeper")


@pytest.mark.long
def test_the_report_does_not_replace_a_figure(found, tmp_path):
    with ledger.opened(), pytest.raises(UsageError, match="two outputs have"):
        write_reproduction(found, tmp_path / "figure2.png", tmp_path)
    assert (tmp_path / "figure2.png").read_bytes().startswith(b"\x89PNG")
