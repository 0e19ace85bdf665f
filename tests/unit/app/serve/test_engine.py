"""The protocol of the page's engine: JSON in, JSON out, the answers those of the command line."""

import gzip
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dashpot.app.serve.engine import carry_out
from tests.two_masses import RIG, UNDETERMINED
from tests.unit.app.conftest import Command


def events(folder: Path, call: str, **more: Any) -> list[dict[str, Any]]:
    heard: list[dict[str, Any]] = []
    carry_out({"call": call, "folder": str(folder), "rig": "rig.toml", **more}, heard.append)
    return heard


def result(folder: Path, call: str, **more: Any) -> dict[str, Any]:
    heard = events(folder, call, **more)
    assert heard[-1] == {"done": True}, heard[-1]
    return [event["result"] for event in heard if "result" in event][-1]


@pytest.mark.long
def test_values_and_intervals_are_those_of_the_command(dashpot: Command, rig: Path, data: Path) -> None:
    assert dashpot(f"identify {rig.name} {data.name} --json command.json --quiet").code == 0
    (rig.parent / "out").mkdir()
    found = result(rig.parent, "identify", data=[data.name], out="out")
    assert found["estimate"] == json.loads((rig.parent / "command.json").read_text(encoding="utf-8"))
    assert {"estimate.json", "fit.svg", "report.html"} <= {*found["files"]}
    shown = {row[0]: row for row in found["parameters"]["rows"]}
    low, high = found["estimate"]["parameters"]["m1"]["interval95"]
    ends = [float(end) for end in shown["m1"][found["parameters"]["heads"].index("95 % interval")].split("…")]
    assert ends == pytest.approx([low, high], rel=0.02)


CHANGES = {
    "value": ({"section": "springs", "name": "k1", "set": {"value": "480"}}, ["value = 480"]),
    "rename": ({"section": "springs", "name": "k1", "rename": "soft"}, ["soft = "]),
    "spring": ({"section": "springs", "name": "k9", "add": {"between": ["x1", "ground"]}}, ["k9 = "]),
    "body": ({"section": "masses", "name": "m9", "add": {"at": "x9"}}, ['"x9"]', "m9 = "]),
    "sensor": (
        {"section": "channels", "name": "a2", "add": {"of": "x2", "quantity": "acceleration", "unit": "g"}},
        ["a2 = "],
    ),
    "removed": ({"section": "dampers", "name": "c1", "remove": True}, []),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_is_one_edit_of_the_text(tmp_path: Path, name: str) -> None:
    change, new = CHANGES[name]
    before = RIG.splitlines()
    after = result(tmp_path, "edit", text=RIG, change=change)["text"].splitlines()
    added = [line for line in after if line not in before]
    assert len(added) == len(new)
    assert all(text in line for text, line in zip(new, added, strict=True))
    assert len([line for line in before if line not in after]) <= 1


@pytest.mark.parametrize(
    "change",
    [
        {"section": "springs", "name": "k1", "set": {"value": "soft"}},
        {"section": "springs", "name": "nobody", "remove": True},
        {"section": "springs", "name": "m1", "add": {"between": ["x1", "x2"]}},
        {"section": "springs", "name": "k9", "add": {"between": ["x1", "nowhere"]}},
        {"section": "springs", "name": " ", "add": {"between": ["x1", "x2"]}},
    ],
)
def test_a_change_that_no_rig_can_have_is_refused_in_one_line(tmp_path: Path, change: dict[str, Any]) -> None:
    failed = events(tmp_path, "edit", text=RIG, change=change)[-1]["failed"]
    assert failed["code"] == 2
    assert all("\n" not in problem["text"] for problem in failed["problems"])


def test_errors_name_their_line(tmp_path: Path) -> None:
    lines = RIG.splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("k1"))
    lines[at] = 'k1 = { between = ["x1", "nowhere"] }'
    failed = events(tmp_path, "open", text="\n".join(lines))[-1]["failed"]
    assert [problem["line"] for problem in failed["problems"]] == [at + 1]


def test_names_are_escaped_in_every_picture(tmp_path: Path) -> None:
    name = "<img src=x onerror=alert(1)>"
    text = (
        RIG.replace("Two masses on a shaken base", name)
        .replace("x2 = {", f'"{name}" = {{')
        .replace("k1 =", f'"{name}k" =')
    )
    opened = result(tmp_path, "open", text=text)
    assert {part["name"] for part in opened["parts"]} >= {f"{name}k"}
    assert "<img" not in opened["drawing"]["svg"]


@pytest.mark.parametrize("path", ["../secret.csv", "/etc/hostname", "link.csv"])
def test_no_file_outside_is_read(tmp_path: Path, path: str) -> None:
    inside = tmp_path / "session"
    inside.mkdir()
    (tmp_path / "secret.csv").write_text("time_s,x\n0,1\n1,2\n2,3\n")
    (inside / "link.csv").symlink_to(tmp_path / "secret.csv")
    failed = events(inside, "inspect", data=[path])[-1]["failed"]
    assert "outside" in failed["problems"][0]["text"]


def test_packed_files_are_read(tmp_path: Path) -> None:
    (tmp_path / "x.csv.gz").write_bytes(gzip.compress(b"time_s,x\n0,1\n1,2\n2,3\n"))
    assert result(tmp_path, "inspect", data=["x.csv.gz"])["files"]


def test_a_folder_that_is_shared_is_read_but_for_other_sessions(tmp_path: Path) -> None:
    own, other = tmp_path / ".dashpot" / "own", tmp_path / ".dashpot" / "other"
    for folder in (tmp_path, own, other):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "x.csv").write_text("time_s,x\n0,1\n1,2\n2,3\n")
    shared = {"reads": [str(tmp_path)]}
    assert events(own, "inspect", data=["x.csv", str(tmp_path / "x.csv")], **shared)[-1] == {"done": True}
    assert "failed" in events(own, "inspect", data=[str(other / "x.csv")], **shared)[-1]


def test_questions_for_data_that_nobody_has_described(tmp_path: Path) -> None:
    rows = "\n".join(f"{i / 100},{i % 7},{i % 5}" for i in range(100))
    (tmp_path / "run.csv").write_text(f"time_s,base (g),acc1\n{rows}\n")
    asked = result(tmp_path, "start", data=["run.csv"])
    assert {question["key"] for question in asked["questions"]} >= {"drive", "unit of acc1"}
    said = result(tmp_path, "start", data=["run.csv"], answers={"unit of acc1": "g", "mass": "2"})
    opened = result(tmp_path, "open", text=said["text"])
    assert [channel["unit"] for channel in opened["channels"]] == ["g", "g"]
    assert next(part["value"] for part in opened["parts"] if part["name"] == "m1") == 2


def damaged() -> dict[str, bytes]:
    """Forty files that are no data any more, by name: of five formats, cut, overwritten, mixed up."""
    from scipy.io import savemat, wavfile

    rng = np.random.default_rng(1)
    x = rng.standard_normal(400)
    files: dict[str, io.BytesIO] = {name: io.BytesIO() for name in ("npz", "mat", "wav")}
    np.savez(files["npz"], time_s=np.arange(400) / 100, x=x)
    savemat(files["mat"], {"time_s": np.arange(400) / 100, "x": x})
    wavfile.write(files["wav"], 1000, (1000 * x).astype(np.int16))
    rows = "time_s,x\n" + "".join(f"{i / 100},{x[i]}\n" for i in range(400))
    whole = {name: stream.getvalue() for name, stream in files.items()}
    whole |= {"csv": rows.encode(), "csv.gz": gzip.compress(rows.encode())}
    spoiled = {}
    for end, content in whole.items():
        size = len(content)
        noise = rng.integers(0, 256, size, dtype=np.uint8).tobytes()
        flipped = np.frombuffer(content, np.uint8) ^ (rng.random(size) < 0.02).astype(np.uint8)
        for kind, bytes_ in {
            "tenth": content[: size // 10], "half": content[: size // 2], "nearly": content[:-7], "noise": noise,
            "headless": content[size // 3 :], "flipped": flipped.tobytes(), "nulls": content[:64] + bytes(size),
            "twice": content[: size // 2] + content,
        }.items():  # fmt: skip
            spoiled[f"{kind}.{end}"] = bytes_
    return spoiled


def test_forty_damaged_files_are_each_answered_in_one_line(tmp_path: Path) -> None:
    files = damaged()
    assert len(files) == 40
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
        last = events(tmp_path, "inspect", data=[name])[-1]
        if "failed" in last:
            assert last["failed"]["code"] == 2, (name, last)
            assert all("\n" not in problem["text"] for problem in last["failed"]["problems"])
    assert {path.name for path in tmp_path.iterdir()} == {*files, ".scratch"}


def test_a_file_that_cannot_be_read_hides_no_other(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("time_s,x\n0,1\n1,2\n2,3\n")
    (tmp_path / "spoiled.npz").write_bytes(damaged()["half.npz"])
    found = result(tmp_path, "inspect", data=["spoiled.npz", "x.csv"])
    assert [file["name"] for file in found["files"]] == ["x.csv"]
    assert [plot["name"] for plot in found["plots"]] == ["x"]
    (problem,) = found["problems"]
    assert problem.startswith("spoiled.npz: ")


def test_where_there_is_no_answer_the_verdict_and_a_report_say_so(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(UNDETERMINED, encoding="utf-8")
    (tmp_path / "data.csv").write_text("frequency_hz,x_re,x_im\n1,1,0\n", encoding="utf-8")
    (tmp_path / "out").mkdir()
    found = result(tmp_path, "identify", data=["data.csv"], out="out")
    assert (found["verdict"], found["estimate"], found["files"]) == ("bad", None, ["report.html"])
    assert found["statements"]


def test_matrices_of_a_rig_are_found_in_the_folder_from_which_it_came(tmp_path: Path) -> None:
    session, frame = tmp_path / "served" / ".dashpot" / "1", tmp_path / "served" / "frame"
    session.mkdir(parents=True)
    frame.mkdir()
    (frame / "K.csv").write_text("2,-1\n-1,1\n", encoding="utf-8")
    text = 'coordinates = ["x", "y"]\n[masses]\nm = { at = "x", value = 1 }\nn = { at = "y" }\n'
    text += '[inputs]\nf = { kind = "force", at = "x" }\n[blocks]\nb = { matrix = "K", file = "K.csv", value = 9 }\n'
    reads = {"text": text, "reads": [str(frame.parent)]}
    assert result(session, "open", **reads, beside=str(frame))["coordinates"] == ["x", "y"]
    assert "K.csv" in events(session, "open", **reads)[-1]["failed"]["problems"][0]["text"]
    elsewhere = events(session, "open", **{**reads, "reads": []}, beside=str(frame))[-1]
    assert "outside the folder" in elsewhere["failed"]["problems"][0]["text"]
