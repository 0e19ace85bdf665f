"""Moments as text."""

import pytest

from dashpot.channel import Channel
from dashpot.data.readers import read
from dashpot.data.readers.columns import is_timestamp, seconds_of
from dashpot.errors import DataError

X = (Channel("x", {"x": 1}),)


@pytest.mark.parametrize(
    "moments",
    [
        ("2025-12-31 23:59:59.75", "2026-01-01 00:00:01.00"),
        ("2025/12/31T23:59:59.75Z", "2026/01/01T00:00:01.00Z"),
        ("31.12.2025 23:59:59,75", "01.01.2026 00:00:01,00"),
        ("31. Dezember 2025 23:59:59.75", "1. Januar 2026 00:00:01"),
        ("31-Dez-2025 23:59:59.75", "01-Jan-2026 00:00:01"),
        ("31-Dec-2025 11:59:59.75 PM", "01-Jan-2026 12:00:01 AM"),
        ("12/31/2025 11:59:59.75 PM", "01/01/2026 12:00:01.00 a.m."),
        ("31/12/2025 23:59:59.75", "01/01/2026 00:00:01"),
        ("05/04/2025 23:59:59.75", "06/04/2025 00:00:01"),
        ("04/05/2025 23:59:59.75", "04/06/2025 00:00:01"),
        ("28. Feb. 2025 23:59:59.75", "1. März 2025 00:00:01"),
        ("23:59:59.75", "00:00:01.00"),
        ("59:59.75", "60:01.00"),
    ],
)
def test_the_time_between_two_moments(moments):
    assert all(map(is_timestamp, moments))
    seconds, wrong = seconds_of(moments)
    assert wrong is None
    assert seconds.tolist() == [0.0, 1.25]


def test_what_is_no_moment():
    assert seconds_of(["1. Mai 2025 12:00:00", "31. Foo 2025 12:00:00"])[1] == 1
    assert seconds_of(["31/12/2025 12:00:00", "41/12/2025 12:00:00"])[1] == 1
    assert not is_timestamp("12")
    assert not is_timestamp("2025-03-06")


@pytest.mark.parametrize(
    ("text", "step"),
    [
        ("Datum;Zeit;x\n" + "".join(f"06.03.2025;12:00:0{k},500;{k},25\n" for k in range(4)), 1.0),
        (
            "rig 7\nhall 3\nDatum;Zeit;x\n"
            + "".join(f"06.03.2025;12:00:0{k},500;{k},25\n" for k in range(4)),
            1.0,
        ),
        ("time_ms,x\n" + "".join(f"{k},{k}.25\n" for k in range(4)), 1e-3),
        ("t_us,x\n" + "".join(f"{k},{k}.25\n" for k in range(4)), 1e-6),
        ("Zeit [min];x\n" + "".join(f"{k};{k},25\n" for k in range(4)), 60.0),
    ],
)
def test_times_in_tables(tmp_path, text, step):
    (tmp_path / "a.csv").write_text(text)
    (record,) = read(tmp_path / "a.csv", X).records
    assert record.time == pytest.approx([step * k for k in range(4)])
    assert record.values[:, 0].tolist() == [0.25, 1.25, 2.25, 3.25]


def test_a_moment_of_another_kind_is_refused_with_the_cure(tmp_path):
    (tmp_path / "a.csv").write_text("time,x\n6 de marzo de 2025 12:00:00,1\n6 de marzo de 2025 12:00:01,2\n")
    with pytest.raises(DataError, match="neither a number"):
        read(tmp_path / "a.csv", X)
    (tmp_path / "a.csv").write_text("x\n1\n2\n")
    with pytest.raises(DataError, match="time_s: missing"):
        read(tmp_path / "a.csv", X)
