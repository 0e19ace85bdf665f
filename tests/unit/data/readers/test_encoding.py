"""Encodings, and what stands behind the end of a text."""

import math

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.data.readers import datafile, read

CHANNELS = Channel("x1", {"x1": 1}, unit="µm", scale=1e-6), Channel("u", {"u": 1})
TEXT = "Prüfstand\ntime_s,x1 [µm],u\n" + "".join(f"{k / 8!r},{math.sin(k)!r},{k}\n" for k in range(60))

WRITTEN = {
    "UTF-8": TEXT.encode(),
    "UTF-8 with a mark": TEXT.encode("utf-8-sig"),
    "Windows": TEXT.encode("cp1252"),
    "UTF-16": TEXT.encode("utf-16"),
    "UTF-16 without a mark": TEXT.encode("utf-16-le"),
    "UTF-16 of the other order": TEXT.encode("utf-16-be"),
    "Macintosh": TEXT.replace("\n", "\r").encode(),
    "DOS": TEXT.replace("\n", "\r\n").encode() + b"\x1a",
    "laid out and not filled": TEXT.encode() + bytes(4096),
}


@pytest.mark.parametrize("large", [False, True])
@pytest.mark.parametrize("name", WRITTEN)
def test_encodings(tmp_path, monkeypatch, name, large):
    (tmp_path / "a.csv").write_bytes(WRITTEN[name])
    if large:
        monkeypatch.setattr(datafile, "LARGE", 100)
    (record,) = read(tmp_path / "a.csv", CHANNELS).records
    assert record.values[:, 0] == pytest.approx(1e-6 * np.sin(np.arange(60)), rel=1e-15)
