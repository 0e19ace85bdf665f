"""Large and odd inputs take time and memory in proportion: each of these took twenty seconds or a gigabyte."""

import itertools
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from dashpot.data.readers import read
from dashpot.errors import DataError, ModelError
from dashpot.model.rigfile import parse_rig
from tests.unit.app.conftest import RIG

SECONDS = 12.0  # of processor time: what took twenty, with room for slow and busy machines
CHANNELS = parse_rig(RIG).channels


def _timed(function: Callable[[], object]) -> object:
    begin = time.process_time()
    try:
        return function()
    finally:
        assert time.process_time() - begin < SECONDS


def _records(path: Path, stamps: list[float]) -> Path:
    rows = [f"1,{stamp!r},{i % 7},1,{i % 3}" for i, stamp in enumerate(stamps)]
    path.write_text("\n".join(["frequency_hz,time_s,x1,x2,u", *rows]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "stamp",
    [
        pytest.param(lambda i: 0.5, id="equal"),
        pytest.param(lambda i: 0.001 * (i % 4), id="restarts", marks=pytest.mark.long),
        pytest.param(lambda i: 0.001 * (i // 2), id="pairs"),
    ],
)
def test_time_stamps_that_stand_still_or_start_again(tmp_path: Path, stamp: Callable[[int], float]) -> None:
    """Four times as many take less than eight times the processor time, once a quarter of them takes any."""
    seconds = []
    for count in (10_000, 40_000):
        path = _records(tmp_path / f"{count}.csv", [stamp(i) for i in range(count)])
        begin = time.process_time()
        with pytest.raises(DataError):
            read(path, CHANNELS).spectrum()
        seconds.append(time.process_time() - begin)
    assert seconds[1] < 8 * max(seconds[0], 0.5)


def _ties(count: int, last: str) -> str:
    names = [*(f"d{i}" for i in range(count)), last]
    lines = [
        f'{one} = {{ between = ["x2", "u"], same_as = "{other}" }}'
        for one, other in itertools.pairwise(names)
    ]
    return RIG.replace("[channels]", "\n".join(lines) + "\n[channels]")


def test_a_chain_of_ties() -> None:
    rig = _timed(lambda: parse_rig(_ties(2000, "c2")))
    assert rig is not None


def test_a_circle_of_ties_is_told_in_short() -> None:
    def attempt() -> None:
        with pytest.raises(ModelError, match="a circular tie") as error:
            parse_rig(_ties(2000, "d0"))
        assert max(len(str(problem)) for problem in error.value.problems) < 400

    _timed(attempt)


@pytest.mark.parametrize("form", ["[{}]\n", "{} = 1\n", "x = {{ {} = 1 }}\n"])
def test_a_key_of_many_parts(form: str) -> None:
    text = form.format(".".join(["a", '"b"'] * 10_000))

    def attempt() -> None:
        with pytest.raises(ModelError, match=r"rig\.toml:\d+: a key"):
            parse_rig(RIG + text)

    _timed(attempt)
