"""Files of measured modes: what they say is read, and whatever is wrong is one line with its place and a cure."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.data.readers.modes import holds_modes, modes_and_notes, read_modes
from dashpot.errors import DataError

X = ("x1", "x2", "x3")
HEADER = "frequency_hz,frequency_sd,damping_ratio,damping_sd,x1_re,x1_im,x1_sd,x3_re,x3_im,x3_sd"
ROWS = ["3.0,0.01,0.02,0.001,1,0,0.01,0.5,-0.1,0.02", "7.5,0.02,0.03,0.002,-0.4,0.1,0.01,1,0,0"]


def csv(tmp_path: Path, rows: list[str], header: str = HEADER) -> Path:
    path = tmp_path / "modes.csv"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def test_csv(tmp_path: Path) -> None:
    found = read_modes(csv(tmp_path, ROWS), X)
    assert found.points == ("x1", "x3")
    assert found.frequency_hz.tolist() == [3.0, 7.5]
    assert found.damping_ratio.tolist() == [0.02, 0.03]
    assert np.allclose(found.covariance[1], np.diag([0.02**2, 0.002**2]))
    assert found.shapes.tolist() == [[1, 0.5 - 0.1j], [-0.4 + 0.1j, 1]]
    # sd of the real and of the imaginary part, each: E|Δ|² is twice its square.
    assert np.allclose(found.shape_covariance[0], np.diag([2 * 0.01**2, 2 * 0.02**2]))


def test_gaps_real_shapes_and_no_damping(tmp_path: Path) -> None:
    """Columns in any order; a shape's point that is not there in one mode; shapes that are real."""
    path = csv(
        tmp_path,
        ["0.01,3.0,1,0.01,,", "0.02,7.5,-0.4,0.01,1,0.02"],
        "frequency_sd,frequency_hz,x2,x2_sd,x1,x1_sd",
    )
    found = read_modes(path, X)
    assert found.points == ("x1", "x2")
    assert np.all(np.isnan(found.damping_ratio))
    assert np.isnan(found.shapes[0, 0])
    assert found.shapes[:, 1].tolist() == [1, -0.4]
    only = read_modes(csv(tmp_path, ["3,0.1"], "frequency_hz,frequency_sd"), X)
    assert only.points == ()
    assert only.shapes.shape == (1, 0)


def test_what_is_without_standard_deviations_gets_usual_ones(tmp_path: Path) -> None:
    """Frequencies alone, damping ratios of which one was not measured, real shapes: of a table and of JSON alike."""
    told = "assumed are 2 % of frequencies, 10 % of damping ratios, 4 % of a shape's largest entry"
    table = csv(tmp_path, ["3,0.02,0.5,-1", "7.5,0,2,"], "frequency_hz,damping_ratio,x1,x2")
    listed = tmp_path / "modes.json"
    shapes = ({"x1": 0.5, "x2": -1}, {"x1": 2})
    rows = [{"frequency_hz": f, "shape": shape} for f, shape in zip((3, 7.5), shapes, strict=True)]
    listed.write_text(json.dumps({"modes": [rows[0] | {"damping_ratio": 0.02}, rows[1]]}))
    for path in (table, listed):
        found, (note,) = modes_and_notes(path, X, relative_sd=(0.02, 0.1, 0.04))
        assert note.text.endswith(told)
        np.testing.assert_allclose(np.diagonal(found.covariance, axis1=1, axis2=2)[:, 0], [0.06**2, 0.15**2])
        np.testing.assert_allclose(found.damping_ratio, [0.02, np.nan])
        assert found.covariance[0, 1, 1] == pytest.approx(0.002**2)
        np.testing.assert_allclose(found.shapes, [[0.5, -1], [2, np.nan]])
        np.testing.assert_allclose(found.shape_covariance[0], 2 * 0.04**2 * np.eye(2))
    alone = csv(tmp_path, ["3", "7.5"], "frequency_hz")
    assert holds_modes(alone)
    assert "assumed are 1 % of frequencies [" in f"{modes_and_notes(alone, X)[1][0].text} ["
    assert not holds_modes(csv(tmp_path, ["3,1,0"], "frequency_hz,x1_re,x1_im"))


def modes() -> list[dict[str, Any]]:
    return [
        {"frequency_hz": 3.0, "frequency_sd": 0.01, "damping_ratio": 0.02, "damping_sd": 0.001,
         "shape": {"x1": [1.0, 0.0], "x3": [0.5, -0.1]}, "shape_sd": {"x1": 0.01, "x3": 0.02}},
        {"frequency_hz": 7.5, "frequency_sd": 0.02, "damping_ratio": 0.03, "damping_sd": 0.002,
         "shape": {"x1": [-0.4, 0.1], "x3": 1}, "shape_sd": {"x1": 0.01, "x3": 0}},
    ]  # fmt: skip


def as_json(tmp_path: Path, content: object) -> Path:
    path = tmp_path / "modes.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


def test_json_says_the_same_as_csv(tmp_path: Path) -> None:
    one, other = read_modes(csv(tmp_path, ROWS), X), read_modes(as_json(tmp_path, {"modes": modes()}), X)
    for name in ("frequency_hz", "damping_ratio", "covariance", "shapes", "shape_covariance"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
    assert one.points == other.points


def test_points_have_the_names_of_channels(tmp_path: Path) -> None:
    """A sensor that counts the other way, and one with a lever; two of one point are told."""
    channels = [Channel("a1", {"x1": -1.0}), Channel("a3", {"x3": 2.0}), Channel("b3", {"x3": 1.0})]
    header = HEADER.replace("x1", "a1").replace("x3", "a3")
    renamed = json.loads(json.dumps(modes()).replace("x1", "a1").replace("x3", "a3"))
    for path in (csv(tmp_path, ROWS, header), as_json(tmp_path, {"modes": renamed})):
        found = read_modes(path, X, channels)
        assert found.points == ("x1", "x3")
        assert found.shapes[0] == pytest.approx([-1, 0.25 - 0.05j])
        assert found.shape_covariance[0] == pytest.approx(np.diag([2 * 0.01**2, 2 * 0.01**2]))
    with pytest.raises(DataError, match="the same point"):
        read_modes(csv(tmp_path, ROWS, header.replace("a1", "b3")), X, channels)


BAD_CSV = {
    "no frequency": (HEADER.replace("frequency_hz", "f"), ROWS, ["frequency_hz"]),
    "no frequency sd": (HEADER.replace("frequency_sd", "fs"), ROWS, ["fs", "not a coordinate"]),
    "damping without sd": (HEADER.replace("damping_sd", "ds"), ROWS, ["ds", "not a coordinate"]),
    "shape without sd": (HEADER.replace("x3_sd", "x3_s"), ROWS, ["x3_sd"]),
    "real part without imaginary": (HEADER.replace("x3_im", "x3_i"), ROWS, ["x3_im"]),
    "unknown point": (HEADER.replace("x3", "y3"), ROWS, ["y3", "not a coordinate"]),
    "point twice": (HEADER.replace("x3_re", "x1"), ROWS, ["x1", "twice"]),
    "no rows": (HEADER, [], ["modes.csv"]),
    "no number": (HEADER, [ROWS[0], ROWS[1].replace("7.5", "high")], ["modes.csv:3", "frequency_hz", "high"]),
    "comma decimals": (HEADER, [ROWS[0].replace("3.0", '"3,0"')], ["modes.csv:2", "3,0"]),
    "negative frequency": (HEADER, ["-" + ROWS[0]], ["modes.csv:2", "frequency_hz", "not positive"]),
    "zero sd": (HEADER, [ROWS[0].replace("0.01,0.02", "0,0.02", 1)], ["modes.csv:2", "frequency_sd"]),
    "negative shape sd": (HEADER, [ROWS[0].replace("1,0,0.01", "1,0,-0.01")], ["modes.csv:2", "x1_sd", "negative"]),
    "damping in percent": (HEADER, [ROWS[0].replace("0.02,0.001", "2,0.1")], ["modes.csv:2", "fraction"]),
    "damping without its sd": (HEADER, [ROWS[0].replace("0.001", "")], ["modes.csv:2", "damping_sd"]),
    "half an amplitude": (HEADER, [ROWS[0].replace("-0.1", "")], ["modes.csv:2", "x3_im", "empty"]),
    "amplitude without sd": (HEADER, [ROWS[0][:-4]], ["modes.csv:2"]),
    "all points exact": (HEADER, [ROWS[0].replace("0,0.01", "0,0").replace("0.02", "0")[:-1] + "0"], ["modes.csv:2"]),
    "infinite": (HEADER, [ROWS[0].replace("3.0", "inf")], ["modes.csv:2", "frequency_hz"]),
    "empty file": ("", [], ["modes.csv"]),
}  # fmt: skip


def complaint(path: Path) -> str:
    with pytest.raises(DataError) as caught:
        read_modes(path, X)
    assert len(caught.value.problems) == 1
    text = str(caught.value.problems[0])
    assert "\n" not in text
    assert "; " in text, f"no cure in: {text}"
    return text


@pytest.mark.parametrize("case", BAD_CSV)
def test_bad_csv(tmp_path: Path, case: str) -> None:
    header, rows, parts = BAD_CSV[case]
    text = complaint(csv(tmp_path, rows, header))
    for part in parts:
        assert part in text


def changed(mode: int, **entries: object) -> dict[str, object]:
    """The good file with keys of one mode replaced, or removed where None."""
    content = modes()
    for key, value in entries.items():
        if value is None:
            del content[mode][key]
        else:
            content[mode][key] = value
    return {"modes": content}


BAD_JSON: dict[str, tuple[object, list[str]]] = {
    "no json": ("{", ["modes.json", "not JSON"]),
    "a list": ([1, 2], ["modes.json", '"modes"']),
    "no modes": ({"modes": []}, ["modes.json", '"modes"']),
    "too deep": ("[" * 100000, ["modes.json", "not JSON"]),
    "unknown key": (changed(1, colour="red"), ["mode 2", "colour"]),
    "no frequency": (changed(1, frequency_hz=None), ["mode 2", "frequency_hz"]),
    "text": (changed(0, frequency_hz="3.0 Hz"), ["mode 1", "frequency_hz", "3.0 Hz"]),
    "not a number": (changed(0, frequency_hz=float("nan")), ["mode 1", "frequency_hz"]),
    "true": (changed(0, frequency_hz=True), ["mode 1", "frequency_hz"]),
    "no sd": (changed(0, frequency_sd=None), ["mode 1", "frequency_sd"]),
    "damping in percent": (changed(0, damping_ratio=2), ["mode 1", "damping_ratio"]),
    "damping without sd": (changed(0, damping_sd=None), ["mode 1", "damping_sd"]),
    "unknown point": (changed(0, shape={"y": 1.0}), ["mode 1", "y", "not a coordinate"]),
    "shape is a list": (changed(0, shape=[1, 2]), ["mode 1", "shape"]),
    "shape of three numbers": (changed(0, shape={"x1": [1, 2, 3]}), ["mode 1", "x1"]),
    "point without sd": (changed(0, shape_sd={"x1": 0.1}), ["mode 1", "x3"]),
    "negative sd": (changed(0, shape_sd={"x1": 0.1, "x3": -0.1}), ["mode 1", "x3", "negative"]),
    "all exact": (changed(0, shape_sd={"x1": 0, "x3": 0}), ["mode 1", "x1_sd"]),
}


@pytest.mark.parametrize("case", BAD_JSON)
def test_bad_json(tmp_path: Path, case: str) -> None:
    content, parts = BAD_JSON[case]
    text = complaint(as_json(tmp_path, content))
    for part in parts:
        assert part in text


def test_files_that_are_not_there(tmp_path: Path) -> None:
    assert "none.csv" in complaint(tmp_path / "none.csv")
    assert "none.json" in complaint(tmp_path / "none.json")
    (tmp_path / "bytes.json").write_bytes(b"\xff\xfe\x00")
    assert "bytes.json" in complaint(tmp_path / "bytes.json")
    (tmp_path / "folder.csv").mkdir()
    assert "folder.csv" in complaint(tmp_path / "folder.csv")
