"""Laws that the data do not show, that nothing tells apart, or that are no numbers: one line each that names them."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.two_masses import one_mass
from tests.unit.app.conftest import Command

CHANNELS = {"x": 'unit = "mm", noise = "2 µm"', "u": 'unit = "mm", noise = "0.01 µm"'}
CUBIC = 'k3 = { between = ["x", "u"], law = "cubic" }'
Recorded = Callable[..., str]


def rig(springs: str = "", dampers: str = "") -> None:
    text = one_mass("u", 'value = "1.5 kg"', of=CHANNELS)
    text = text.replace("[dampers]", f"{springs}\n[dampers]").replace("[channels]", f"{dampers}\n[channels]")
    Path("rig.toml").write_text(text, encoding="utf-8")


def sprung(law: str) -> str:
    return f'q = {{ between = ["x", "u"], law = {law} }}'


@pytest.fixture(scope="module")
def made() -> dict[tuple[str, float, float], bytes]:
    """Files of `recorded` that were made."""
    return {}


@pytest.fixture
def recorded(dashpot: Command, made: dict[tuple[str, float, float], bytes]) -> Recorded:
    """Dwells or a whole record of the rig with a cubic spring, by dashpot itself."""

    def record(kind: str, k3: float, rms: float = 7e-4) -> str:
        if file := made.get((kind, k3, rms)):
            Path("data.csv").write_bytes(file)
            return "data.csv"
        rig(CUBIC)
        sets = ["--set", f"k=2500,k3={k3:g},c=6", "--seed", "3", "--out", "data.csv"]
        if kind == "dwells":
            sets += ["--frequencies", "3:12:1", "--amplitude", f"{rms:g}m"]
        else:
            rng, time = np.random.default_rng(1), np.arange(600) / 100
            tones, phases = rng.uniform(2, 14, 40), rng.uniform(0, 6.3, 40)
            u = np.sum(np.cos(2 * np.pi * tones * time[:, None] + phases), axis=1)
            table = np.column_stack([time, u * 1e3 * rms / np.std(u)])  # mm
            np.savetxt("u.csv", table, "%.9g", ",", header="time_s,u", comments="")
            sets += ["--input", "u.csv"]
        assert dashpot("simulate", "rig.toml", *sets).code == 0
        made[kind, k3, rms] = Path("data.csv").read_bytes()
        return "data.csv"

    return record


@pytest.mark.parametrize("kind", ["dwells", "record"])
@pytest.mark.parametrize(
    ("law", "what"),
    [
        ("'exp(1e6*d)'", "overflows"),
        ("'exp(1e6*v)'", "overflows"),
        ("'d/(1 - 1000*d)'", "divides by zero"),
        ("'log(1 + 1000*d)'", "is not defined"),
        ("'sqrt(1e-3 - d)'", "is not defined"),
    ],
)
def test_a_law_that_is_no_number_in_the_measured_motion_is_refused(
    dashpot: Command, recorded: Recorded, kind: str, law: str, what: str
) -> None:
    data = recorded(kind, 2e7)
    rig(sprung(law))
    done = dashpot("identify", "rig.toml", data, "--quiet")
    assert done.code == 2
    (line,) = done.err
    assert f"of q {what} within the measured motion ({'v' if 'v' in law else 'd'} runs from -" in line
    assert "finite there" in line


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "springs", "dampers", "names"),
    [
        ("dwells", sprung('"gap", gap = 50e-3'), "", ["no information on q"]),
        ("record", sprung("'d**300'"), "", ["no information on q"]),
        ("dwells", f"{CUBIC}\n{sprung(repr('2*d**3'))}", "", ["k3", "q"]),
        ("record", "", sprung('"coulomb", v0 = 100.0'), ["c", "q"]),
        ("dwells", sprung('"bilinear", ratio = "unknown"'), "", ["k", "q", "q.ratio"]),
    ],
)
def test_laws_that_leave_no_trace_or_that_nothing_tells_apart_are_named(
    dashpot: Command, recorded: Recorded, kind: str, springs: str, dampers: str, names: list[str]
) -> None:
    data = recorded(kind, 2e5)
    rig(springs, dampers)
    done = dashpot("identify", "rig.toml", data, "--quiet")
    assert done.code == 3
    line = done.err[0]  # another may name what the data call for instead
    assert all(name in line for name in names), line
    assert "no information" in line if "no information" in names[0] else "unchanged" in line
    assert "; " in line


@pytest.mark.parametrize("kind", ["dwells", "record"])
def test_a_clearance_that_is_never_passed_is_named_after_the_search_as_well(
    dashpot: Command, recorded: Recorded, kind: str
) -> None:
    data = recorded(kind, 0.0)
    rig(
        sprung('"gap", gap = { guess = 0.5 }') + '\nk2 = { between = ["x", "u"], value = 1.0, law = "cubic" }'
    )
    done = dashpot("identify", "rig.toml", data, "--quiet")
    assert done.code == 3
    assert all("q" in line and "no information" in line for line in done.err)


@pytest.mark.slow
def test_a_motion_too_small_for_the_law_gives_the_linear_values_and_says_so(
    dashpot: Command, recorded: Recorded
) -> None:
    """Springs made of noise once led to values from which no motion follows."""
    data = recorded("record", 2e7, 7e-7)
    done = dashpot("identify", "rig.toml", data)
    assert done.code == 0
    (line,) = [
        line
        for line in done.out.replace("\n", " ").split("Warning: ")
        if line.startswith("the data do not show")
    ]
    assert "k3: its interval includes 0" in line


@pytest.mark.long
def test_friction_fitted_to_a_stiffening_spring_does_not_fit_and_the_spring_is_named(
    dashpot: Command, recorded: Recorded
) -> None:
    data = recorded("record", 2e7)
    rig("", 'fc = { between = ["x", "u"], law = "coulomb", v0 = "unknown" }')
    done = dashpot("identify", "rig.toml", data)
    said = " ".join(" ".join([done.out, *done.err]).split())
    assert "odd, stiffening (p < 1e-6), in place of fc" in said
    assert "no information on fc.v0" in said
    assert done.code == 3


@pytest.mark.parametrize("law", ['"cubic"', '"coulomb", v0 = 0.1'])
def test_a_free_decay_has_no_input(dashpot: Command, law: str) -> None:
    """Of a linear rig, x = exp(−t/2) cos 20 t: k = 1.2 (20² + 1/4) N/m, c = 1.2 N·s/m, and of the law nothing."""
    text = one_mass("", "value = 1.2", of={"x": 'unit = "mm"'}, q=f"law = {law}")
    Path("rig.toml").write_text(text, encoding="utf-8")
    time = np.arange(150) / 100
    x = np.exp(-0.5 * time) * np.cos(20 * time) + 1e-3 * np.random.default_rng(1).standard_normal(150)
    np.savetxt("data.csv", np.column_stack([time, x]), "%.9g", ",", header="time_s,x", comments="")
    assert dashpot("identify", "rig.toml", "data.csv", "--json", "e.json").code == 0
    found = json.loads(Path("e.json").read_text(encoding="utf-8"))["parameters"]
    for name, true in {"k": 480.3, "c": 1.2, "q": 0.0}.items():
        assert abs(found[name]["value"] - true) < 4 * found[name]["sd"], name
    assert found["k"]["sd"] < 0.2
