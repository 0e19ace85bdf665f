"""The public verbs as people type them, and values as they show themselves."""

from __future__ import annotations

import inspect
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import dashpot
from dashpot import Estimate, Rig, api
from dashpot.app.cli import run
from dashpot.data.readers import write_records
from tests.two_masses import RIG, VALUES
from tests.whole_rigs import chain, record_of


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Rig:
    monkeypatch.chdir(tmp_path)
    Path("rig.toml").write_text(RIG, encoding="utf-8")
    rig = dashpot.read_rig("rig.toml")
    write_records(list(rig.simulate(VALUES, "1:15/8log", amplitudes={"u": 0.01}, seed=1)), "data.csv")
    return rig


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
        places = [
            order.index(argument) for argument in inspect.signature(value).parameters if argument in order
        ]
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


def test_values_by_name(rig: Rig) -> None:
    estimate = rig.identify("data.csv")
    assert abs(estimate["m1"].value - 3) < 4 * estimate["m1"].sd < 0.2


def test_what_is_printed_is_what_the_command_prints(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    estimate = rig.identify("data.csv")
    assert run(["identify", "rig.toml", "data.csv"]) == 0
    table = capsys.readouterr().out
    shown = str(estimate)
    for line in shown.splitlines()[:12]:  # below, the command adds its verdict
        assert line in table
    assert "± is one standard deviation" in shown


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


def test_a_plot_has_a_panel_for_each_unknown(rig: Rig) -> None:
    figure = rig.identify("data.csv").plot()
    assert "<svg" in figure._repr_svg_()  # what notebooks show
    assert isinstance(figure, Figure)
    assert [axes.get_title(loc="left") for axes in figure.axes if axes.get_visible()] == ["m1", "c1", "c2"]


def test_compare_takes_names(rig: Rig) -> None:
    found = rig.compare("data.csv", ["wls", "oiv"], truth=VALUES)
    assert list(found.estimates) == ["wls", "oiv"]


def test_check_before_and_with_data(rig: Rig) -> None:
    assert rig.check().identifiable
    assert rig.check("data.csv").identifiable


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


def test_continuous_records_of_nonlinear_rigs_are_integrated(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    bent, answer = dashpot.parse_rig(NONLINEAR), rig.identify("data.csv")
    asked: list[object] = []

    class Integrated:
        def estimate(self) -> Estimate:
            return answer

    def integrated(model: object, records: object, method: object, **_: object) -> Integrated:
        asked[:] = [model, records, method]
        return Integrated()

    monkeypatch.setattr(api, "fit_records", integrated)
    table = {name: np.zeros(50) for name in ("x1", "x2", "u")} | {"time_s": np.arange(50) / 100}
    record = dashpot.record(table, bent.channels)
    assert bent.identify(record).values is answer.values
    assert asked == [bent.model, (record,), None]
    assert rig.read("data.csv").continuous is False


def test_a_whole_record_is_judged_by_the_noise_that_its_fit_rests_on() -> None:
    """Python once judged by none: a channel that read 1.3 times as much from the middle on passed as a fit."""
    model, theta = chain(2, 0.05, base=True, seed=2)
    record = record_of(model, theta, "random", decay_times=40, seed=1).record
    rng = np.random.default_rng(4)
    noise = 0.02 * record.values.std(axis=0) * rng.normal(size=record.values.shape) * [1, 1, 0]
    estimate = dashpot.identify(model, replace(record, values=record.values + noise), diagnose=True)
    assert estimate.assessment is not None
    assert estimate.assessment.verdict == "cannot tell"
    values = record.values + noise
    values[len(values) // 2 :, 1] *= 1.3
    estimate = dashpot.identify(model, replace(record, values=values), diagnose=True)
    assert estimate.assessment is not None
    assert estimate.assessment.verdict == "does not fit"
    first = estimate.assessment.findings[0]
    assert (first.kind, first.of) == ("time", ("x2_dis",))
    said = re.search(r"after ([\d.]+) s", first.text)
    assert said is not None
    assert float(said[1]) == pytest.approx(record.time[len(values) // 2], rel=0.02)


def test_a_model_that_cannot_be_found_is_refused_as_a_rig_is_and_all_its_unknowns_named() -> None:
    """24 coordinates of which nothing is known were searched for minutes."""
    model, theta = chain(24)
    free = replace(model, elements=tuple(replace(element, value=None) for element in model.elements))
    channels = [dashpot.Channel(name, {name: 1.0}, noise=1e-5) for name in (*model.coordinates, "u")]
    sines = dashpot.dwells(model, np.linspace(1, 20, 30), 16)
    p = model.parameters(theta)
    spectrum = dashpot.simulate_spectrum(model, p, channels, sines, np.random.default_rng(0))
    with pytest.raises(dashpot.IdentifiabilityError, match="nothing is known") as refused:
        dashpot.identify(free, spectrum)
    words = set(re.findall(r"\w+", str(refused.value)))
    assert words >= {element.name for element in free.elements}
