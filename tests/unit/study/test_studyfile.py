"""Study files: what is read, and one line with a place, a cause and a cure for all that is wrong."""

from pathlib import Path

import numpy as np
import pytest

from dashpot.errors import UsageError
from dashpot.reproduce import yamane1989
from dashpot.study.montecarlo import run_study
from dashpot.study.scenario import scenarios
from dashpot.study.studyfile import read_study
from tests.two_masses import one_mass

EXAMPLES = Path(__file__).parents[3] / "examples" / "07_studies"

CHANNELS = {"x": "noise = 0.01", "v": 'of = "x", quantity = "velocity"', "u": ""}
RIG = one_mass("u", "", "value = 4600", "guess = 30", CHANNELS)
STUDY = """\
draws = 100
methods = ["oiv"]
[rigs.one]
file = "rig.toml"
values = { m = 3.0 }
[frequencies]
few = [1, 2, 5]
[[grid]]
noise = [0.1]
samples = 56
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG)
    return tmp_path


def parsed(folder, text):
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return read_study(folder / "study.toml")


@pytest.mark.parametrize("which", ["tables", "figures"])
def test_the_papers_study_files_are_what_reproduce_computes(which):
    """Same names (so same random numbers), same physics, same methods and draws: the same bits."""
    study = read_study(EXAMPLES / f"yamane1989_{which}.toml")
    own = getattr(yamane1989, f"{which}_study")()
    assert study.seed == own.seed
    for one, other in zip(scenarios(study), scenarios(own), strict=True):
        assert one.name == other.name
        assert one.key == other.key
        assert one.fingerprint == other.fingerprint
        assert (one.methods, one.draws) == (other.methods, other.draws)


def test_a_short_file_has_sensible_defaults(folder):
    study = parsed(folder, STUDY)
    (one,) = scenarios(study)
    assert study.name == "study"
    assert study.seed == 0
    assert one.theta.tolist() == [3.0, 30.0]  # the damper's is its guess
    assert one.noise == "given"
    assert one.drift is None
    assert one.test.samples.tolist() == [56, 56, 56]
    assert one.methods == ("oiv",)


def test_everything_that_can_be_said(folder):
    text = STUDY.replace("draws = 100", 'name = "all"\nseed = 4\ndrift = 1\nperiods = 3').replace(
        "[[grid]]\nnoise = [0.1]\nsamples = 56",
        """\
sweep = { from = 1, to = 100, count = 3, spacing = "logarithmic" }
even = { from = 1, to = 3, count = 3 }
[unknowns]
mass = ["m"]
[amplitudes]
u = 0.01
[[grid]]
draws = 10
frequencies = ["sweep", "even"]
unknowns = ["all", "mass"]
kind = "constant"
reference = "few"
noise = [0.1, 0.2]
samples_in_all = [30, 60]
covariance = ["given", "estimated"]
methods = ["ls", "oiv"]
[[grid]]
draws = 20
kind = "channels"
samples = [8]
frequencies = "few"
""",
    )
    study = parsed(folder, text)
    points = scenarios(study)
    assert len(points) == 2**5 + 1
    assert np.allclose(points[0].test.frequency_hz, [1, 10, 100])
    assert points[0].test.U[0, 0] == 0.01
    assert points[0].test.periods[0] == 3
    assert points[0].drift == 1
    assert points[-1].draws == 20
    assert points[-1].channels[0].noise == 0.01
    assert {point.noise for point in points} == {"given", "estimated"}


def test_rigs_and_sets_of_unknowns_in_one_study(folder):
    """Two rigs with different unknowns, all of them and a set: each row says whose it is and has its own truth."""
    (folder / "pair.toml").write_text(
        RIG.replace('["x"]', '["x", "y"]')
        .replace("m = {", 'n = { at = "y" }\nm = {')
        .replace("k = {", 'h = { between = ["x", "y"], value = 900 }\nk = {')
        .replace("u = { of", 'y = { of = "y" }\ndy = { of = "y", quantity = "velocity" }\nu = { of')
    )
    text = STUDY.replace(
        "[frequencies]",
        """\
[rigs.pair]
file = "pair.toml"
values = { m = 3.0, n = 1.0 }
[unknowns]
mass = ["m"]
[frequencies]""",
    ).replace("samples = 56", 'samples = 56\nrigs = ["one", "pair"]\nunknowns = ["all", "mass"]')
    table = run_study(parsed(folder, text)).columns()
    rows = list(zip(*(table[key] for key in ("rig", "unknowns", "parameter", "true_value")), strict=True))
    assert rows == [
        ("one", "all", "m", 3.0), ("one", "all", "c", 30.0), ("one", "mass", "m", 3.0),
        ("pair", "all", "n", 1.0), ("pair", "all", "m", 3.0), ("pair", "all", "c", 30.0), ("pair", "mass", "m", 3.0),
    ]  # fmt: skip
    # 100 draws know a spread to 7 % (1 sd); what is known already makes the rest no worse.
    assert all(0.75 < efficiency < 1.4 for efficiency in table["efficiency"])
    bound = dict(zip([row[:3] for row in rows], table["bound"], strict=True))
    assert bound["one", "mass", "m"] < bound["one", "all", "m"]
    assert bound["pair", "mass", "m"] < bound["pair", "all", "m"]
    assert not any(table["failed"])


WRONG = [
    ("[rigs.one]", '[rigs."\\u202eone"]', '3: rigs."\\u202eone": "\\u202eone" is not a usable name'),
    ("draws = 100", 'draws = 100\nname = "a\\u001bb"', '2: name: "a\\u001bb" is not a usable name'),
    ("draws = 100", "draw = 100", '1: draw: unknown key; did you mean "draws"?'),
    ("draws = 100", "", "8: grid[0]: the number of draws is not given; add draws = 1000"),
    ("draws = 100", "draws = 1", "1: draws: 1 is out of range; write a whole number from 2"),
    ("draws = 100", "draws = 1e3", "1: draws: 1000.0 is not a whole number"),
    ("draws = 100", 'draws = "many"', '1: draws: "many" is not a whole number'),
    ("draws = 100", "draws = true", "1: draws: true is not a whole number"),
    ("draws = 100", "draws = 100\nseed = -1", "2: seed: -1 is out of range"),
    ("draws = 100", "draws = 100\nperiods = 0", "2: periods: 0 is not positive"),
    ("draws = 100", "draws = 100\nperiods = nan", "2: periods: nan is not finite"),
    ('["oiv"]', '["oivv"]', '2: methods: "oivv" is not a method; did you mean "oiv"?'),
    ('["oiv"]', "[]", "2: methods: the list is empty"),
    ('["oiv"]', '["oiv", "oiv"]', '2: methods: "oiv" appears twice in the list'),
    ('["oiv"]', "[3]", "2: methods[0]: 3 is not text"),
    ('file = "rig.toml"\n', "", "3: rigs.one.file: missing"),
    ("rig.toml", "rag.toml", "there is no such file"),
    ("values = { m = 3.0 }", "", "3: rigs.one: the true value of m is not given; add values = { m = … }"),
    ("{ m = 3.0 }", "{ m = 3.0, q = 1 }", "5: rigs.one.values.q: the rig has no such parameter of its own"),
    ("{ m = 3.0 }", '{ m = "3" }', '5: rigs.one.values.m: "3" is text'),
    ("{ m = 3.0 }", "{ m = inf }", "5: rigs.one.values.m: inf is not finite"),
    ("{ m = 3.0 }", "3", "3: rigs.one: this is not a table"),
    ("[1, 2, 5]", "[1, -2, 5]", "7: frequencies.few[1]: -2 is not positive"),
    ("[1, 2, 5]", "[1, 2, 1]", "7: frequencies.few: 1 appears twice"),
    ("[1, 2, 5]", "3", "7: frequencies.few: these are not frequencies; write a list"),
    ("[1, 2, 5]", '"all"', "7: frequencies.few: 'all' is not a frequency; write frequencies as 1,2,5"),
    ("[1, 2, 5]", "{ from = 1, to = 5 }", "7: frequencies.few.count: missing"),
    ("[1, 2, 5]", "{ from = 5, to = 1, count = 4 }", "7: frequencies.few: from 5 is not below to 1"),
    ("[1, 2, 5]", "{ from = 1, to = 5, count = 4, spacing = 'log' }", 'few.spacing: "log" is not one of'),
    ("[frequencies]\nfew = [1, 2, 5]\n", "", "frequencies: there are no frequencies"),
    ("noise = [0.1]\n", "", "8: grid[0]: the noise is not given; add noise = [0.01, 0.1]"),
    ("noise = [0.1]", "noise = [-0.1]", "9: grid[0].noise[0]: a noise of -0.1"),
    ("noise = [0.1]", 'noise = ["10 mm"]', "9: grid[0].noise"),
    ("noise = [0.1]", 'noise = ["-10 %"]', "9: grid[0].noise[0]: a noise of -0.1"),
    ("noise = [0.1]", "nois = [0.1]", '9: grid[0].nois: unknown key; did you mean "noise"?'),
    (
        "noise = [0.1]",
        "noise = 0.1\nkind = 'constant'",
        "8: grid[0]: constant noise needs a reference amplitude; add",
    ),
    ("noise = [0.1]", "noise = 0.1\nkind = ['relative', 'constant']", "10: grid[0].kind: more than one kind"),
    ("noise = [0.1]", "noise = 0.1\nkind = 'white'", '10: grid[0].kind: "white" is not one of'),
    ("noise = [0.1]", "noise = 0.1\nreference = 'few2'", '10: grid[0].reference: "few2" is not a set'),
    ("samples = 56", "", "8: grid[0]: the number of samples is not given"),
    ("samples = 56", "samples = 1", "10: grid[0].samples[0]: 1 is out of range"),
    ("samples = 56", "samples_in_all = 5", "8: grid[0]: 5 samples are too few for 3 frequencies; use 6"),
    ("samples = 56", "samples = 56\nsamples_in_all = 60", "8: grid[0]: samples and samples_in_all are both"),
    ("samples = 56", "samples = 56\nfrequencies = 'many'", '11: grid[0].frequencies: "many" is not a set'),
    ("samples = 56", "samples = 56\nunknowns = 'two'", '11: grid[0].unknowns: "two" is not a set'),
    ("samples = 56", "samples = 56\nrigs = 'two'", '11: grid[0].rigs: "two" is not a rig; choose from one'),
    ("samples = 56", "samples = 56\ncovariance = 'guessed'", '11: grid[0].covariance[0]: "guessed"'),
    ("[[grid]]\nnoise = [0.1]\nsamples = 56\n", "", "grid: there is no grid; add [[grid]]"),
    ("[frequencies]", "[unknowns]\nall = ['m']\n[frequencies]", "7: unknowns.all: the name all is taken"),
    (
        "[frequencies]",
        "[unknowns]\ntwo = ['m', 'z']\n[frequencies]",
        '7: unknowns.two: "z" is not a parameter',
    ),
    ("[frequencies]", "[amplitudes]\nw = 1\n[frequencies]", "7: amplitudes.w: no rig has this input"),
    ("[frequencies]", "[frequencies", "6: Expected ']' at the end of a table declaration"),
    ("[rigs.one]", "rigs = 5\n[one]", "3: rigs: this is not a table"),
]


@pytest.mark.parametrize(("old", "new", "message"), WRONG)
def test_what_is_wrong_is_told_in_one_line_with_its_place(folder, old, new, message):
    assert old in STUDY
    with pytest.raises(UsageError) as caught:
        parsed(folder, STUDY.replace(old, new, 1))
    told = str(caught.value)
    assert message in told
    assert all(line.startswith(str(folder)) for line in told.splitlines())


def test_all_problems_are_told_at_once(folder):
    text = (
        STUDY.replace("100", "0")
        .replace("0.1", "-1")
        .replace("[1, 2, 5]", "[0]")
        .replace("m = 3.0", "n = 3.0")
    )
    with pytest.raises(UsageError) as caught:
        parsed(folder, text)
    assert len(caught.value.problems) == 5


def test_a_rig_file_in_the_place_of_a_study_is_told_so(folder):
    with pytest.raises(UsageError, match="this is a rig file, not a study") as caught:
        parsed(folder, 'coordinates = ["x"]\n[masses]\nm = { at = "x" }\n')
    assert len(caught.value.problems) == 1


@pytest.mark.parametrize("end", range(20, len(STUDY) - 12, 7))
def test_a_file_cut_short_never_passes_nor_crashes(folder, end):
    """Cut anywhere before its grid is complete, it is refused."""
    with pytest.raises(UsageError):
        parsed(folder, STUDY[:end])


@pytest.mark.parametrize(("text", "expected"), [("1:3:0.5", [1, 1.5, 2, 2.5, 3]), ("1,2:4/3", [1, 2, 3, 4])])
def test_frequencies_in_the_syntax_of_the_command_line(folder, text, expected):
    (one,) = scenarios(parsed(folder, STUDY.replace("[1, 2, 5]", f'"{text}"')))
    assert one.test.frequency_hz.tolist() == expected


def test_values_levels_and_amplitudes_may_carry_units(folder):
    """The same study in SI numbers and in units and per cent."""
    plain = STUDY.replace("[frequencies]", "[amplitudes]\nu = 0.002\n[frequencies]")
    dressed = (
        plain.replace("u = 0.002", 'u = "2 mm"')
        .replace("noise = [0.1]", 'noise = ["10 %"]')
        .replace("m = 3.0", 'm = "3000 g"')
    )
    assert dressed.count('"') == plain.count('"') + 6
    (one,), (other,) = scenarios(parsed(folder, plain)), scenarios(parsed(folder, dressed))
    assert other.theta.tolist() == pytest.approx(one.theta.tolist(), rel=1e-15)
    assert other.test.U[0, 0] == pytest.approx(0.002)
    assert other.factors["noise"] == pytest.approx(0.1)


def test_nonlinear_rigs_need_the_size_of_their_drive(folder):
    bent = RIG.replace("[channels]", 'k3 = { between = ["x", "u"], law = "cubic", guess = 1e9 }\n[channels]')
    (folder / "rig.toml").write_text(bent)
    with pytest.raises(UsageError, match=r"depends on the drive level"):
        parsed(folder, STUDY)
    assert (
        len(
            scenarios(
                parsed(folder, STUDY.replace("[frequencies]", "[amplitudes]\nu = 0.001\n[frequencies]"))
            )
        )
        == 1
    )


def test_a_study_simulates_one_experiment_of_a_rig(folder):
    (folder / "rig.toml").write_text(
        RIG + '[experiments.heavy]\nk = 9200\nmasses.extra = { at = "x", value = 1 }\n'
    )
    with pytest.raises(UsageError, match=r"rigs\.one\.experiment"):
        parsed(folder, STUDY)
    heavy = parsed(folder, STUDY.replace('file = "rig.toml"', 'file = "rig.toml"\nexperiment = "heavy"'))
    assert {e.name for e in heavy.rigs["one"].model.elements} == {"m", "c", "k@heavy", "extra"}
    plain = parsed(folder, STUDY.replace('file = "rig.toml"', 'file = "rig.toml"\nexperiment = "none"'))
    assert {e.name for e in plain.rigs["one"].model.elements} == {"m", "c", "k"}
