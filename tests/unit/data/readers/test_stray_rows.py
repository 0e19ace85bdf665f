"""What laboratories put between and around the rows of numbers: read as the plain table, or refused in one line."""

import gzip
import math

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.data.inspection import inspect_file
from dashpot.data.readers import datafile, read
from dashpot.errors import DataError

CHANNELS = Channel("x1", {"x1": 1}, unit="mm", scale=1e-3), Channel("u", {"u": 1}, unit="mm", scale=1e-3)
HEAD, ROWS = "time_s,x1,u", [f"{k / 8!r},{math.sin(k)!r},{-k / 4!r}" for k in range(40)]
PLAIN = "\n".join([HEAD, *ROWS]) + "\n"


def page(rows, *heading):
    return "\n".join([*heading, *rows]) + "\n"


ODD = {
    "header on each page": (page(ROWS[:20], HEAD) + page(ROWS[20:], HEAD), "1 row repeating the header"),
    "header and units on each page": (
        page(ROWS[:20], HEAD, "s,mm,mm") + page(ROWS[20:], HEAD, "s,mm,mm"),
        "2 rows repeating the header",
    ),
    "title and header on each page": (
        page(ROWS[:20], "Hall 3, rig 7", HEAD) + "\f" + page(ROWS[20:], "Hall 3, rig 7", HEAD),
        "2 rows repeating the header",
    ),
    "form feeds": ("\f".join([page(ROWS[:20], HEAD), page(ROWS[20:])]), None),
    "comments": (page([*ROWS[:9], "# operator paused", *ROWS[9:], "% end"], HEAD), "2 comments"),
    "spaces": (page([*ROWS[:20], HEAD, *ROWS[20:]], HEAD).replace(",", "  "), "1 row repeating the header"),
    "line ends of Windows": (
        page([*ROWS[:20], HEAD, "# paused", *ROWS[20:]], HEAD).replace("\n", "\r\n"),
        "1 row repeating the header, 1 comment",
    ),
    "delimiters at the ends of rows": (page([row + "," for row in ROWS], HEAD), None),
    "delimiters at all ends": (page([row + "," for row in ROWS], HEAD + ","), None),
    "a header that numpy.savetxt comments out": ("# " + PLAIN, None),
    "a header that begins with %": ("%" + PLAIN, None),
    "minus signs of typesetting": (PLAIN.replace("-", "\u2212"), None),
    "units behind strokes": (PLAIN.replace(HEAD, "t / s,x1 / mm,u / mm"), None),
    "units behind in": (PLAIN.replace(HEAD, "time in s,x1 in mm,u in mm"), None),
}


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("large", [False, True])
@pytest.mark.parametrize("name", ODD)
def test_odd_files_are_read_as_the_plain_one(tmp_path, monkeypatch, name, large, packed):
    text, note = ODD[name]
    (tmp_path / "plain.csv").write_text(PLAIN)
    odd = tmp_path / "odd.csv"
    odd.write_bytes(gzip.compress(text.encode()) if packed else text.encode())
    (plain,) = read(tmp_path / "plain.csv", CHANNELS).records
    if large:
        monkeypatch.setattr(datafile, "LARGE", 100)
    reading = read(odd, CHANNELS)
    np.testing.assert_array_equal(reading.records[0].values, plain.values)
    np.testing.assert_array_equal(reading.records[0].time, plain.time)
    told = [notice.text for notice in reading.notes]
    assert told == ([] if note is None else [f"{odd}: left out {note}"])


def test_rows_keep_their_numbers(tmp_path):
    rows = [*ROWS[:9], "# operator paused", HEAD, *ROWS[9:20], "2.6,#N/A,1", *ROWS[21:]]
    (tmp_path / "odd.csv").write_text(page(rows, HEAD))
    with pytest.raises(DataError, match=r'odd.csv:24: column x1: "#N/A"'):
        read(tmp_path / "odd.csv", CHANNELS)


@pytest.mark.parametrize(
    ("cell", "cure"),
    [
        ('"1,234.5"', "write numbers without"),
        ("1'234.5", "write numbers without"),
        ("1.234.567", "write numbers without"),
        ("1\u202f234", "write numbers without"),
        ("1.5D+03", "write powers of ten"),
        ("#N/A", "correct it, or remove"),
    ],
)
def test_cells_are_refused_with_what_cures_them(tmp_path, cell, cure):
    (tmp_path / "odd.csv").write_text(page([*ROWS, f"9,{cell},1"], HEAD))
    with pytest.raises(DataError, match=r'odd.csv:42: column x1: ".*" is not a number; ' + cure):
        read(tmp_path / "odd.csv", CHANNELS)


def test_inspection_says_what_cannot_be_read(tmp_path):
    """Not that no column holds numbers; and what is damaged in one column beside others."""
    (tmp_path / "short.csv").write_text(page([*ROWS, "End of data"], HEAD))
    with pytest.raises(DataError, match=r"short.csv:42: the row has 1"):
        inspect_file(tmp_path / "short.csv")
    (tmp_path / "gap.csv").write_text(page([*ROWS, "9,OVER,1", "# end"], HEAD))
    (part,) = inspect_file(tmp_path / "gap.csv").parts
    assert [column.name for column in part.columns] == ["u"]
    assert [error.problems[0].what for error in part.damaged] == ['column x1: "OVER" is not a number']
    assert [notice.code for notice in part.notes] == ["stray_rows"]


def test_inspection_of_moments(tmp_path):
    """Beside which no other column is asked for its numbers at the same time."""
    (tmp_path / "odd.csv").write_text(
        page([f"2025-03-06 12:00:{k:02d},{k},1" for k in range(20)], "time,x1,u")
    )
    (part,) = inspect_file(tmp_path / "odd.csv").parts
    assert part.rates_hz == (1.0, 1.0)
