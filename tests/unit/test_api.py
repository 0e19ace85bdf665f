"""The public verbs as people type them, and values as they show themselves."""

import inspect
import math
import pickle
import re
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import dashpot
from dashpot import Estimate, Rig
from dashpot.app.cli import run
from dashpot.data.readers import write_records
from dashpot.shorthand import refusing
from tests.two_masses import RIG, VALUES
from tests.whole_rigs import chain


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Rig:
    monkeypatch.chdir(tmp_path)
    Path("rig.toml").write_text(RIG, encoding="utf-8")
    rig = dashpot.read_rig("rig.toml")
    write_records(list(rig.simulate(VALUES, "1:15/8log", amplitudes={"u": 0.01}, seed=1)), "data.csv")
    return rig


@pytest.mark.slow
def test_every_way_to_say_it_gives_the_same(rig: Rig) -> None:
    plain = dashpot.identify(rig.model, dashpot.read("data.csv", rig.channels).spectrum())
    records = dashpot.read("data.csv", rig).records
    for estimate in (
        rig.identify("data.csv"),
        rig.identify(Path("data.csv")),
        rig.identify(["data.csv"]),
        rig.identify(rig.read("data.csv")),
        rig.identify(records),
        rig.identify(rig.read("data.csv").spectrum()),
        dashpot.identify(rig, "data.csv"),
        dashpot.identify(rig, "data.csv", "oiv"),
    ):
        np.testing.assert_array_equal(estimate.values, plain.values)
        np.testing.assert_array_equal(estimate.covariance, plain.covariance)


READS = {"read", "read_modes", "record", "records_of"}  # begin with what is read, then the channels


def test_arguments_come_in_one_order_everywhere() -> None:
    """The rig or the model, what is known of it, the channels, the data, how; channels once, where they were read."""
    order = [
        "rig", "model", "estimate", "theta", "p", "values", "channels", "spectrum", "data", "test", "rng", "method",
    ]  # fmt: skip
    for name in dashpot.__all__:
        value = getattr(dashpot, name)
        if not inspect.isfunction(value) or name in READS:
            continue
        given = inspect.signature(value).parameters.values()
        by_place = [each.name for each in given if each.kind is not inspect.Parameter.KEYWORD_ONLY]
        places = [order.index(argument) for argument in by_place if argument in order]
        assert places == sorted(places), name
    for name in READS:
        first, second, *_ = inspect.signature(getattr(dashpot, name)).parameters
        assert first in {"paths", "path", "data"}, name
        assert second in {"channels", "coordinates"}, name


def test_a_record_alone_is_data(rig: Rig) -> None:
    """One dwell at 3 Hz fixes two combinations of amplitudes and phases: enough for one damper."""
    known = dashpot.parse_rig(RIG.replace('m1 = { at = "x1" }', 'm1 = { at = "x1", value = 3 }'))
    (record,) = known.simulate({"c1": 20.0, "c2": 30.0}, [3.0], amplitudes={"u": 0.01})
    assert known.identify(record).names == ("c1", "c2")


def test_a_model_reads_files_by_the_names_of_its_coordinates(rig: Rig) -> None:
    by_model = dashpot.identify(rig.model, "data.csv", "ml")
    # The file is in mm and the model's own channels are in m: nothing but ratios enters a rig moved at its base.
    np.testing.assert_allclose(by_model.values, rig.identify("data.csv", "ml").values, rtol=0.02)


def test_what_is_printed_is_what_the_command_prints(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    estimate = rig.identify("data.csv")
    assert run(["identify", "rig.toml", "data.csv"]) == 0
    table = capsys.readouterr().out
    shown = str(estimate)
    for line in shown.splitlines():
        assert line in table
    assert "The model fits" in shown


def test_one_line_each(rig: Rig) -> None:
    estimate = rig.identify("data.csv")
    records = rig.read("data.csv").records
    reading = rig.read("data.csv")
    for value in (rig, estimate, estimate["m1"], records[0], reading, reading.spectrum()):
        text = repr(value)
        assert "\n" not in text
        assert len(text) < 400
        assert "array(" not in text
    assert "m1 = 3" in repr(estimate)
    assert "m1 = 3" in repr(estimate["m1"])


def test_a_batch_is_one_line(rig: Rig) -> None:
    model = rig.model
    p = model.parameters(model.theta(VALUES))
    test = dashpot.dwells(model, [1.0, 2, 4, 8], 200)
    many = dashpot.simulate_spectrum(model, p, rig.channels, test, np.random.default_rng(0), draws=3)
    estimates = rig.identify(many)
    assert repr(estimates).startswith("<3 estimates by oiv of m1, c1, c2")
    assert str(estimates) == repr(estimates)


def test_notebooks_get_tables_without_scripts(rig: Rig) -> None:
    records = rig.read("data.csv").records
    for value in (rig, records[0], rig.read("data.csv").spectrum(), rig.identify("data.csv")):
        html = value._repr_html_()
        assert html.startswith(("<table>", "<p>"))
        assert html.count("<table>") == html.count("</table>") >= 1


@pytest.mark.slow
def test_a_plot_has_a_panel_for_each_response_or_each_unknown(rig: Rig) -> None:
    estimate = rig.identify("data.csv")
    for values, titles in ((False, ["x1 over u", "", "x2 over u", ""]), (True, ["m1", "c1", "c2"])):
        figure = estimate.plot(values=values)
        assert "<svg" in figure._repr_svg_()  # what notebooks show
        assert isinstance(figure, Figure)
        assert [axes.get_title(loc="left") for axes in figure.axes if axes.get_visible()] == titles


def test_what_cannot_be_found_is_refused_as_by_the_command(rig: Rig) -> None:
    parallel = dashpot.parse_rig(RIG.replace("[channels]", 'c3 = { between = ["x1", "x2"] }\n[channels]'))
    with pytest.raises(dashpot.IdentifiabilityError, match=r"c1 \+ c3"):
        parallel.identify("data.csv")


def test_a_spectrum_is_not_conditioned_again(rig: Rig) -> None:
    spectrum = rig.read("data.csv").spectrum()
    with pytest.raises(dashpot.UsageError, match="conditioned already"):
        rig.identify(spectrum, conditioning=dashpot.Conditioning(settle="auto"))


def test_values_saved_before_are_shown_again(rig: Rig) -> None:
    estimate = rig.identify("data.csv")
    Path("e.json").write_text(estimate.to_json(), encoding="utf-8")
    assert repr(Estimate.load("e.json")) == repr(estimate)


NONLINEAR = RIG.replace(
    "[dampers]", 'k3 = { between = ["x1", "u"], law = "cubic", guess = 4e7 }\n\n[dampers]', 1
)


def test_nonlinear_dwells_and_manifests_are_treated_as_by_the_command(
    rig: Rig, capsys: pytest.CaptureFixture[str]
) -> None:
    """Python once took the fundamentals of nonlinear dwells alone, and left what a manifest says unread."""
    Path("bent.toml").write_text(NONLINEAR, encoding="utf-8")
    Path("test.toml").write_text('[conditioning]\norders = [1, 2]\n[[files]]\nname = "data.csv"\n')
    values = "m1=3,c1=20,c2=30,k3=4e7"
    made = ["simulate", "bent.toml", "--set", values, "--frequencies", "2:12/8", "--amplitude", "2mm"]
    assert run([*made, "--out", "bent.csv", "-q"]) == 0
    for name, file in (("bent.toml", "bent.csv"), ("rig.toml", "test.toml")):
        assert run(["identify", name, file, "--json", "e.json", "-q"]) == 0
        command, python = Estimate.load("e.json"), dashpot.read_rig(name).identify(file)
        np.testing.assert_allclose(python.values, command.values, rtol=1e-12)
        assert python.fit.dof == command.fit.dof
    capsys.readouterr()


def test_a_model_that_cannot_be_found_is_refused_as_a_rig_is_and_all_its_unknowns_named() -> None:
    """24 coordinates of which nothing is known were searched for minutes."""
    model, theta = chain(24)
    free = replace(model, elements=tuple(replace(element, value=None) for element in model.elements))
    channels = [dashpot.Channel(name, {name: 1.0}, noise=1e-5) for name in (*model.coordinates, "u")]
    sines = dashpot.dwells(model, np.linspace(1, 20, 30), 16)
    p = model.parameters(theta)
    spectrum = dashpot.simulate_spectrum(model, p, channels, sines, np.random.default_rng(0))
    with pytest.raises(dashpot.IdentifiabilityError, match="is known") as refused:
        dashpot.identify(free, spectrum)
    words = set(re.findall(r"\w+", str(refused.value)))
    assert words >= {element.name for element in free.elements}


def columns(records: tuple[dashpot.Record, ...]) -> dict[str, np.ndarray]:
    """Dwells as one table by name."""
    names = [channel.name for channel in records[0].channels]
    table = {
        "frequency_hz": np.concatenate([np.full(len(one.time), one.frequency_hz) for one in records]),
        "time_s": np.concatenate([one.time for one in records]),
    }
    values = np.concatenate([one.values for one in records])
    return table | dict(zip(names, values.T, strict=True))


@pytest.mark.slow
def test_tables_of_any_library_are_data(rig: Rig) -> None:
    pandas, polars, xarray = (pytest.importorskip(name) for name in ("pandas", "polars", "xarray"))
    table = columns(rig.read("data.csv").records)
    expected = rig.identify("data.csv")
    for data in (
        table,
        pandas.DataFrame(table),
        polars.DataFrame(table),
        xarray.Dataset({name: ("sample", values) for name, values in table.items()}),
        [pandas.DataFrame(table)],
    ):
        found = rig.identify(data)
        np.testing.assert_allclose(found.values, expected.values, atol=1e-9 * expected.sd.min(), rtol=1e-12)
    for wrong in (5, None, object(), {"time_s": [0.0, 1.0]}, [3]):
        with pytest.raises(dashpot.DashpotError):
            rig.identify(wrong)


def test_a_rig_judges_unless_it_is_told_not_to(rig: Rig) -> None:
    spectrum = rig.read("data.csv").spectrum()
    assert rig.identify("data.csv").assessment.verdict == "fits"
    assert rig.identify("data.csv", judge=False).assessment is None
    assert rig.identify("data.csv", diagnose=False).assessment is None
    assert dashpot.identify(rig.model, spectrum).assessment is None
    assert dashpot.identify(rig.model, spectrum, judge=True).assessment.verdict == "fits"
    batch = replace(spectrum, amplitudes=np.stack([spectrum.amplitudes] * 2))
    assert rig.identify(batch).assessment is None


@pytest.mark.slow
def test_a_frequency_response_is_that_of_the_rig_and_its_spread_that_of_draws(rig: Rig) -> None:
    estimate = rig.identify("data.csv")
    hz = np.array([[1.0, 4.0], [7.0, 12.0]])
    value, sd = estimate.frf("x2", "u", hz)
    p = rig.model.parameters(estimate.values)
    moved = dashpot.response(rig.model, p, 2 * np.pi * hz.ravel(), np.ones((4, 1)), np.zeros((4, 0)))
    np.testing.assert_allclose(value, moved[:, 1].reshape(2, 2), rtol=1e-9)
    rng = np.random.default_rng(3)
    drawn = np.array(
        [
            estimate.with_values(**dict(zip(estimate.names, theta, strict=True))).frf("x2", "u", hz)[0]
            for theta in rng.multivariate_normal(estimate.values, estimate.covariance, 1500)
        ]
    )
    both = np.sqrt((drawn.real.var(axis=0) + drawn.imag.var(axis=0)) / 2)
    np.testing.assert_allclose(
        sd, both, rtol=0.08
    )  # 1,500 draws of both parts: 1.8 % each, and the slope's bend
    one, spread = estimate.frf("x2", "u", 4.0)
    assert (one, spread) == (value[0, 1], sd[0, 1])
    for wrong in (("x9", "u"), ("x2", "x1"), ("u", "u")):
        with pytest.raises(dashpot.UsageError):
            estimate.frf(*wrong, 4.0)


def test_values_are_changed_and_known_ones_too(rig: Rig) -> None:
    estimate = rig.identify("data.csv")
    other = estimate.with_values(c1=25.0, m2=4.0)
    j = estimate.names.index("c1")
    kept = [k for k in range(len(estimate.names)) if k != j]
    assert (other["c1"].value, other["c1"].sd, other["c1"].bound_sd) == (25.0, 0.0, 0.0)
    np.testing.assert_array_equal(other.values[kept], estimate.values[kept])
    np.testing.assert_array_equal(
        other.covariance[np.ix_(kept, kept)], estimate.covariance[np.ix_(kept, kept)]
    )
    assert other.parameters()["m2"].value == 4.0
    assert other.modes is not None
    model = dashpot.parse_rig(RIG.replace("2.7", "4")).model
    np.testing.assert_allclose(
        other.modes.frequency_hz, dashpot.modes(model, model.parameters(other.values)).frequency_hz
    )
    Path("e.json").write_text(estimate.to_json(), encoding="utf-8")
    loaded = Estimate.load("e.json").with_values(c1=25.0, m2=4.0)
    for same in (loaded.frf("x1", "u", 3.0), other.frf("x1", "u", 3.0, rig)):
        assert same[0] == pytest.approx(other.frf("x1", "u", 3.0)[0], rel=1e-9)
    assert abs(other.frf("x1", "u", 3.0)[0] / estimate.frf("x1", "u", 3.0)[0] - 1) > 0.01
    for wrong in ({"zeta": 1.0}, {"c1": "much"}, {"c1": float("nan")}):
        with pytest.raises(dashpot.UsageError):
            estimate.with_values(**wrong)


def test_an_estimate_predicts_motion_with_its_uncertainty(rig: Rig) -> None:
    estimate = rig.identify("data.csv")
    time = np.arange(0, 8, 0.005)
    inputs = {"time_s": time, "u": 10.0 * np.sin(2 * np.pi * 3.0 * time)}  # mm, the unit of the channel
    (predicted,) = estimate.simulate(inputs)
    amplitude, spread = estimate.frf("x1", "u", 3.0)
    column = [channel.name for channel in predicted.channels].index("x1")
    settled = time > 6
    assert predicted.sd is not None
    motion = 0.01 * (amplitude * np.exp(2j * np.pi * 3.0 * time)).imag
    np.testing.assert_allclose(
        predicted.values[settled, column], motion[settled], atol=2e-3 * abs(motion).max()
    )
    rms = np.sqrt(np.mean(predicted.sd[settled, column] ** 2))  # over whole periods
    assert rms == pytest.approx(0.01 * spread, rel=0.02)
    (clean,) = replace(rig, channels=tuple(replace(c, noise=0.0) for c in rig.channels)).simulate(
        estimate.parameters(), inputs
    )
    np.testing.assert_allclose(clean.values[:, column], predicted.values[:, column], rtol=1e-9, atol=1e-12)
    (stiffer,) = estimate.simulate(inputs, m2=6.0)
    assert np.abs(stiffer.values - predicted.values).max() > 0.05 * abs(motion).max()


@pytest.mark.slow
def test_an_estimate_writes_its_report(rig: Rig) -> None:
    estimate = rig.identify("data.csv")
    assert estimate.report("r.html") == "r.html"
    page = Path("r.html").read_text(encoding="utf-8")
    assert "Residuals" in page
    assert "data.csv" in page
    Path("e.json").write_text(estimate.to_json(), encoding="utf-8")
    Estimate.load("e.json").report("again.html")
    assert "c1" in Path("again.html").read_text(encoding="utf-8")
    with pytest.raises(dashpot.UsageError):
        estimate.report("r.docx")


FUNCTIONS = [name for name in dashpot.__all__ if inspect.isfunction(getattr(dashpot, name))]
REFUSING = [name for name in FUNCTIONS if name != "mass"]  # whose name is refused by the Model that has it


@pytest.mark.parametrize("wrong", [None, b"abc", 3, math.nan])
def test_arguments_of_other_types_are_named(wrong: object, rig: Rig) -> None:
    for name in REFUSING:
        function = getattr(dashpot, name)
        needed = [one for one in inspect.signature(function).parameters.values() if one.default is one.empty]
        options = {one.name: wrong for one in needed if one.kind is one.KEYWORD_ONLY}
        positional = [wrong for one in needed if one.kind is one.POSITIONAL_OR_KEYWORD]
        with pytest.raises(dashpot.DashpotError) as refused:
            function(*positional, **options)
        assert "\n" not in str(refused.value)
    with pytest.raises(dashpot.UsageError, match="identify: conditioning is 3"):
        rig.identify("data.csv", conditioning=3)


def test_arguments_are_refused_in_words_and_take_units(rig: Rig) -> None:
    frame = types.SimpleNamespace(columns=["x1"])
    with pytest.raises(dashpot.UsageError, match=r"path is a SimpleNamespace; give the name of a file"):
        dashpot.read_rig(frame)  # type: ignore[arg-type]
    estimate = rig.identify("data.csv")
    with pytest.raises(dashpot.UsageError, match="give the name of a file"):
        estimate.report(None)
    assert estimate.with_values(c1="25 N·s/m", m1="4000 g")["m1"].value == pytest.approx(4.0)
    with pytest.raises(dashpot.UsageError, match=r"c1: .*unit of damping"):
        estimate.with_values(c1="25 kg")
    given, same = ({**VALUES, "m2": mass} for mass in ("4000 g", 4.0))
    pair = [dashpot.simulate(rig, values, [2.0], seed=1)[0] for values in (given, same)]
    assert pair[0].values == pytest.approx(pair[1].values)


def test_public_functions_are_found_again_by_pickle_and_leave_faults_of_their_own() -> None:
    assert all(
        pickle.loads(pickle.dumps(getattr(dashpot, name))) is getattr(dashpot, name) for name in FUNCTIONS
    )

    def faulty(number: "float") -> float:
        return number / 0

    with pytest.raises(ZeroDivisionError):
        refusing(faulty)(1.0)
    with pytest.raises(TypeError, match="missing 1 required"):
        refusing(faulty)()


@pytest.mark.parametrize("size", [1e-120, 1e-160, 1e-310, 5e-324])
def test_denormals_are_nothing_and_raise_no_warning(size: float, rig: Rig) -> None:
    records = [replace(record, values=size * record.values) for record in rig.read("data.csv").records]
    assert not any(np.any(record.values) for record in records)
    with pytest.raises(dashpot.IdentifiabilityError):
        rig.identify(records)


def test_counts_and_lists_that_cannot_be_are_refused(rig: Rig) -> None:
    test = dashpot.dwells(rig.model, [2.0, 3.0], 64)
    p, rng = rig.model.parameters(rig.model.theta(VALUES)), np.random.default_rng(0)
    for wrong in (
        lambda: dashpot.simulate_spectrum(rig.model, p, rig.channels, test, rng, draws=-1),
        lambda: dashpot.simulate_spectrum(rig.model, p, rig.channels, test, rng, drift=-1),
        lambda: dashpot.concatenate([]),
        lambda: rig.identify([]),
        lambda: rig.simulate({**VALUES, b"m": 3.0}, [2.0]),  # type: ignore[dict-item]
        lambda: rig.simulate(VALUES, b"2:14"),
        lambda: rig.simulate(VALUES, ["a"]),
        lambda: rig.simulate(VALUES, []),
        lambda: rig.simulate(VALUES, 1e-320),
        lambda: dashpot.Channel("x1", None),  # type: ignore[arg-type]
        lambda: dashpot.Record(None, None, None),  # type: ignore[arg-type]
        lambda: dashpot.Record(rig.channels, [0, 1], [[1, 2], [3]]),  # type: ignore[arg-type]
        lambda: dashpot.Record(rig.channels, [0, 1], [["a"], ["b"]]),  # type: ignore[arg-type]
    ):
        with pytest.raises(dashpot.DashpotError):
            wrong()
