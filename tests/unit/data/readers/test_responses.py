"""Files of one frequency response each: named by their file, joined, averaged, weighted by the coherence."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dashpot
from dashpot.arrays import Complex, Real
from dashpot.channel import Channel, Quantity
from dashpot.data.readers import read
from dashpot.data.readers.responses import coherent_variance
from dashpot.data.readers.uff import FRF, NodalFunction, NodePoint
from dashpot.data.readers.uff_writer import write_universal_file
from dashpot.errors import DataError
from tests.two_masses import HELD

RIG = dashpot.parse_rig(f"""
coordinates = ["x1", "x2"]
[inputs]
f = {{ kind = "force", at = "x1" }}
{HELD.replace("value", "guess")}[channels]
a1 = {{ of = "x1", quantity = "acceleration", unit = "g" }}
a2 = {{ of = "x2", quantity = "acceleration", unit = "m/s^2" }}
hammer = {{ of = "f", unit = "N" }}
""")
TRUTH = {"m1": 2.0, "m2": 1.0, "k1": 8000.0, "k2": 3000.0, "c1": 8.0, "c2": 3.0}
HZ = np.arange(3, 20, 0.25)


def responses() -> Complex:
    """H of a1 (g/N) and a2 (m/s²/N) to the hammer, (lines, 2), written out."""
    M, K, C = (
        np.diag([2.0, 1.0]),
        np.array([[11e3, -3e3], [-3e3, 3e3]]),
        np.array([[11.0, -3.0], [-3.0, 3.0]]),
    )
    w = 2 * np.pi * HZ[:, None, None]
    X = np.linalg.solve(K - w**2 * M + 1j * w * C, np.broadcast_to(np.array([[1.0], [0.0]]), (len(HZ), 2, 1)))
    return -(w[:, 0] ** 2) * X[..., 0] / np.array([9.80665, 1.0])


def write(name: str, header: str, *columns: Real) -> str:
    rows = "\n".join("\t".join(f"{value:.8g}" for value in row) for row in np.column_stack([HZ, *columns]))
    Path(name).write_text(f"Analyser 7, window: exponential\n{header}\n{rows}\n")
    return name


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def forms(name: str, H: Complex, form: str) -> str:
    degrees = np.rad2deg(np.angle(H))
    if form == "dB and degrees":
        return write(name, "Frequency\tMagnitude [dB]\tPhase [deg]", 20 * np.log10(np.abs(H)), degrees)
    if form == "dB unsaid":
        return write(name, "Frequency\tMagnitude\tPhase", 20 * np.log10(np.abs(H)), degrees)
    if form == "linear and radians":
        return write(name, "Frequency [Hz]\tMagnitude\tPhase [rad]", np.abs(H), np.angle(H))
    if form == "row of units":
        unit = "g/N" if "a1" in name else "(m/s^2)/N"
        header = f"Frequency\tMagnitude\tPhase\tCoherence\n[Hz]\t[{unit}]\t[deg]\t[-]"
        return write(name, header, np.abs(H), degrees, np.ones(len(H)))
    return write(name, "Freq\tReal\tImag", H.real, H.imag)


@pytest.mark.parametrize(
    "form", ["dB and degrees", "dB unsaid", "linear and radians", "row of units", "parts"]
)
def test_files_are_joined_by_their_names(form: str) -> None:
    H = responses()
    files = [forms("H_a1_hammer.txt", H[:, 0], form), forms("a2-over-hammer.txt", H[:, 1], form)]
    reading = RIG.read(files)
    assert reading.amplitudes is not None
    assert len(np.unique(reading.amplitudes.experiment)) == 1
    assert any(note.code == "magnitude_in_db" for note in reading.notes) == (form == "dB unsaid")
    estimate = RIG.identify(files, judge=False)
    for name, value in TRUTH.items():
        assert estimate[name].value == pytest.approx(value, rel=1e-4)


def of_units(form: str, unit: tuple[str, str]) -> str:
    """A file of a1 over the hammer in m/s² and N, which states other units where asked."""
    H = responses()[:, 0] * 9.80665
    if form == "universal file":
        function = NodalFunction(FRF, NodePoint("a1"), NodePoint("hammer"), HZ, H, unit[0], unit[1])
        write_universal_file("h.uff", functions=[function])
        return "h.uff"
    if form == "table":
        rows = "\n".join(f"{f!r},{h.real!r},{h.imag!r}" for f, h in zip(HZ.tolist(), H.tolist(), strict=True))
        both = ",".join(f"a1/hammer_{part} [({unit[0]})/{unit[1]}]" for part in ("re", "im"))
        Path("h.csv").write_text(f"frequency_hz,{both}\n{rows}\n", encoding="utf-8")
        return "h.csv"
    header = f"Frequency [Hz]\tReal [({unit[0]})/{unit[1]}]\tImag [({unit[0]})/{unit[1]}]"
    return write("H_a1_hammer.txt", header, H.real, H.imag)


@pytest.mark.parametrize("form", ["universal file", "table", "text"])
def test_units_of_a_response_are_those_of_the_rig_file_or_used_where_it_has_none(form: str) -> None:
    """m/s² taken for g made every mass, damper and spring wrong by 9.81, and fitted as well."""
    stated = [
        Channel("a1", {"x1": 1}, Quantity.ACCELERATION, "m/s²"),
        Channel("hammer", {"f": 1}, Quantity.FORCE, "N"),
    ]
    silent = [replace(channel, unit="") for channel in stated]
    in_g = [replace(stated[0], unit="g", scale=9.80665), stated[1]]
    expected = responses()[:, 0] * 9.80665
    for channels in (stated, silent):
        lines = read([of_units(form, ("m/s^2", "N"))], channels).amplitudes
        assert lines is not None
        np.testing.assert_allclose(lines.amplitudes[:, 0], expected, rtol=1e-6)
    for unit, factor in ((("mm/s^2", "N"), 1e-3), (("m/s^2", "kN"), 1e-3), (("mm/s^2", "mN"), 1.0)):
        lines = read([of_units(form, unit)], silent).amplitudes
        assert lines is not None
        np.testing.assert_allclose(lines.amplitudes[:, 0], expected * factor, rtol=1e-6)
    with pytest.raises(DataError, match=r"column a1: in m/s\^2, the rig file says g"):
        read([of_units(form, ("m/s^2", "N"))], in_g)
    with pytest.raises(DataError, match="column hammer: in lbf, the rig file says N"):
        read([of_units(form, ("m/s^2", "lbf"))], stated)


def test_scatter_of_repeated_taps_is_the_noise() -> None:
    """Six taps of each response with 2 % noise: values within what ± says; without repeats it is unknown."""
    rng, H, files = np.random.default_rng(8), responses(), []
    for tap in range(6):
        noise = 0.02 * np.abs(H) * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape))
        for j, name in enumerate(("a1", "a2")):
            files.append(forms(f"tap{tap}_{name}_hammer.txt", (H + noise)[:, j], "parts"))
    spectrum = RIG.read(files).amplitudes
    assert spectrum is not None
    assert spectrum.lines == len(HZ)
    assert set(spectrum.noise) == {"periods"}
    sd = spectrum.sd()[:, 0] / np.abs(spectrum.amplitudes[:, 0])
    assert np.sqrt(np.mean(sd**2)) == pytest.approx(0.02 / np.sqrt(6), rel=0.15)
    estimate = RIG.identify(files, judge=False)
    z = [(estimate[name].value - value) / estimate[name].sd for name, value in TRUTH.items()]
    assert np.max(np.abs(z)) < 4


@pytest.mark.parametrize("stated", [True, False])
def test_coherence_weighs_the_lines(stated: bool) -> None:
    """Half of the band is poor: γ² = 0.5 against 0.999 of 16 averages; the values follow the good half."""
    rng, H = np.random.default_rng(5), responses()
    gamma2 = np.where(HZ < 11, 0.5, 0.999)
    sd = np.sqrt((1 - gamma2) / (2 * 16 * gamma2))[:, None] * np.abs(H)
    noisy = H + sd * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape))
    more = [gamma2, *([np.full(len(HZ), 16.0)] if stated else [])]
    header = "Frequency\tReal\tImag\tCoherence" + ("\taverages" if stated else "")
    files = [
        write(f"{name}_hammer.txt", header, noisy[:, j].real, noisy[:, j].imag, *more)
        for j, name in enumerate(("a1", "a2"))
    ]
    reading = RIG.read(files)
    assert any(note.code == "averages_unknown" for note in reading.notes) != stated
    estimate = RIG.identify(files, judge=False)
    z = [(estimate[name].value - value) / estimate[name].sd for name, value in TRUTH.items()]
    assert np.max(np.abs(z)) < 4
    assert estimate["m2"].sd < 0.01
    if stated:
        assert 0.6 < float(estimate.fit.chi2) / estimate.fit.dof < 1.5


def test_a_table_of_responses_may_have_its_coherence() -> None:
    """Poor lines, which are wrong by half, count for next to nothing."""
    H = responses()
    poor = HZ < 6
    H[poor] *= 1.5
    gamma2 = np.where(poor, 1e-4, 0.9999)
    parts = [part for h in H.T for part in (h.real, h.imag, gamma2)]
    names = "\t".join(f"{name}/hammer_{end}" for name in ("a1", "a2") for end in ("re", "im", "coherence"))
    estimate = RIG.identify(write("frf.txt", f"frequency_hz\t{names}", *parts), judge=False)
    for name, value in TRUTH.items():
        assert estimate[name].value == pytest.approx(value, rel=0.01)


def test_the_size_of_coherent_noise_is_that_of_neighbouring_lines() -> None:
    """Of 25 averages in 400 lines of a smooth response: the variance to 10 % (median of 398 values)."""
    rng, frequency = np.random.default_rng(2), np.linspace(0, 1, 400)
    H, gamma2 = 1 / (1 + 1j * frequency), np.linspace(0.6, 0.95, 400)
    true = np.abs(H) ** 2 * (1 - gamma2) / (2 * 25 * gamma2)
    noisy = H + np.sqrt(true) * (rng.standard_normal(400) + 1j * rng.standard_normal(400))
    variance, said = coherent_variance(noisy, gamma2, None)
    assert said
    assert np.median(variance / true) == pytest.approx(1, rel=0.1)
    np.testing.assert_allclose(coherent_variance(H, gamma2, np.full(400, 25.0))[0], true)


@pytest.mark.parametrize(
    ("name", "columns", "cause"),
    [
        ("run7.txt", "Frequency\tReal\tImag\tCoherence", r"which response.*such as H_a1_hammer\.csv"),
        ("a1_hammer.txt", "Frequency\tReal\tImag\tCoherence", "a coherence of 7"),
        ("a1_hammer.txt", "Frequency [kg]\tReal\tImag\tCoherence", "not a unit of frequency"),
    ],
)
def test_what_cannot_be_meant_is_refused_in_one_line(name: str, columns: str, cause: str) -> None:
    H = responses()
    with pytest.raises(dashpot.DataError, match=cause) as refused:
        RIG.read(write(name, columns, H[:, 0].real, H[:, 0].imag, np.full(len(HZ), 7.0)))
    assert len(refused.value.problems) == 1


def test_the_order_of_a_files_name_counts_and_a_force_on_a_moved_base_is_no_input() -> None:
    """Force over displacement stays what it is; where the base drives, a force without a file was not measured."""
    stand = (Channel("F", {"u": 1.0}, Quantity.FORCE), Channel("u", {"u": 1.0}), Channel("x", {"x": 1.0}))
    columns = "Frequency\tReal\tImag"
    file = write("H_F_u.txt", columns, np.full(len(HZ), 5e4), np.zeros(len(HZ)))
    other = write("H_x_u.txt", columns, np.ones(len(HZ)), np.zeros(len(HZ)))
    spectrum = read([file, other], stand).amplitudes
    assert spectrum is not None
    np.testing.assert_allclose(spectrum.amplitudes, np.tile([5e4, 1.0, 1.0], (len(HZ), 1)))
    alone = read([other], stand).amplitudes
    assert alone is not None
    assert np.all(np.isnan(alone.amplitudes[:, 0]))
