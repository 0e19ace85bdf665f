"""What data can tell of nonlinear elements, and dwells between folds."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.check.deficiencies import require_identifiable
from dashpot.check.identifiability import blind_laws, nonlinear_structure
from dashpot.check.verdict import several_motions
from dashpot.errors import IdentifiabilityError
from dashpot.estimate.identify import identify
from dashpot.model.elements import Kind, between
from dashpot.model.nonlinear.continuation import followed, frequency_sweep
from dashpot.model.nonlinear.force_law import Constant, force_law
from dashpot.model.nonlinear.harmonics import Drive
from tests.networks import changed, network
from tests.nonlinear_rigs import LAWS, motions, settled, two_masses

ALL = motions("x1", "x2", "u")
FREQUENCIES = [2, 3, 4, 5, 6, 7, 8, 9.5, 11]


def joined(name, law, constants=()):
    return replace(between(name, Kind.SPRING, "x2", "u"), force_law=force_law(law, constants))


QUICK = ("cubic", "coulomb", "gap", "jenkins")
SLOW = [law for law in LAWS if law not in (*QUICK, "bouc-wen")]


@pytest.mark.parametrize("law", [*QUICK, *(pytest.param(law, marks=pytest.mark.long) for law in SLOW)])
def test_every_law_can_be_found_where_all_is_seen(law):
    assert nonlinear_structure(two_masses(law)[0], ALL).identifiable


def test_masses_of_a_shaken_rig_are_known_up_to_a_factor_whatever_its_laws():
    model, _ = two_masses("cubic")
    free = replace(model, elements=tuple(replace(e, value=None) for e in model.elements))
    found = nonlinear_structure(free, ALL)
    assert found.rank == len(found.names) - 1
    assert set(found.deficiencies[0].names) == set(found.names)


def test_a_bilinear_spring_beside_a_linear_one_has_one_slope_too_many():
    model, _ = two_masses("bilinear")
    beside = replace(model.elements[3], value=None)
    found = nonlinear_structure(
        replace(model, elements=(*model.elements[:3], beside, *model.elements[4:])), ALL
    )
    assert [set(one.names) for one in found.deficiencies] == [{"k2", "q", "q.ratio"}]


def test_laws_that_no_drive_tells_apart_and_elements_that_do_not_move_are_named():
    model, theta = two_masses("cubic")
    spectrum = settled(model, theta, ALL, FREQUENCIES)
    twin = replace(model, elements=(*model.elements, joined("kk", "d*d**2")))
    with pytest.raises(IdentifiabilityError, match="q, kk can change together"):
        require_identifiable(twin, ALL, None, spectrum)
    far = replace(model, elements=(*model.elements, joined("kg", "gap", [Constant("gap", 1.0)])))
    with pytest.raises(IdentifiabilityError, match="no information on kg"):
        require_identifiable(far, ALL, None, spectrum)
    assert blind_laws(model, spectrum) is None


def test_data_are_refused_for_the_unknowns_that_cannot_be_told_apart_and_no_others():
    model, theta = two_masses("bilinear")
    spectrum = settled(model, theta, ALL, FREQUENCIES[::2], orders=(1, 2))
    opened = changed(model, "k2", value=None)
    with pytest.raises(IdentifiabilityError, match=r"k2, q, q\.ratio can change together"):
        require_identifiable(opened, ALL, "rig.toml", spectrum)


def test_dwells_between_folds_are_named():
    spring = between("k3", Kind.SPRING, "x", "ground")
    model = network("x", "f@x", "m@x k:x-ground c:x-ground", replace(spring, force_law=force_law("cubic")))
    theta = np.array([1.0, 1.0, 0.1, 1.0])
    channels = (*motions("x"), Channel("f", {"f": 1.0}, Quantity.FORCE))
    omega = np.array([0.6, 1.0, 1.6, 2.6])
    spectrum = settled(model, theta, channels, omega / (2 * np.pi), amplitude=0.3, orders=(1, 3))
    f = np.zeros((1, 8, 1), dtype=complex)
    f[0, 1] = 0.3
    drive = Drive(omega[:1], np.zeros((1, 8, 0), dtype=complex), f)
    raised = followed(model, theta, frequency_sweep(drive, 1.6)).motion.X[-1, :, 0]
    amplitudes = spectrum.amplitudes.copy()
    amplitudes[4:6, 0] = raised[[1, 3]]
    swept = replace(spectrum, amplitudes=amplitudes)
    estimate = identify(model, swept, "ml")
    assert np.max(np.abs(estimate.values / theta - 1)) < 1e-5
    assert "0.2546 Hz" in several_motions(model, swept, estimate)[0].text
    assert several_motions(model, spectrum, estimate) == []
