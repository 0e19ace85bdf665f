"""Periodic responses against the equation of motion in time, against closed forms, and slopes against differences."""

import numpy as np
import pytest

from dashpot.model.dynamics import response
from dashpot.model.elements import Kind, between
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import period_basis
from dashpot.model.nonlinear.force_law import force_law
from dashpot.model.nonlinear.harmonic_balance import (
    harmonic_unit_forces,
    periodic_response,
    slopes,
    truncation,
)
from dashpot.model.nonlinear.harmonics import Drive
from tests.networks import network
from tests.nonlinear_rigs import IN_ROWS, LAWS, chain, two_masses

FREQUENCIES = np.array([2.0, 4.0, 6.5, 9.0, 14.0])


def drive_of(orders, amplitude=1e-3):
    U = np.zeros((len(FREQUENCIES), orders + 1, 1), dtype=complex)
    U[:, 1, 0] = amplitude
    return Drive(2 * np.pi * FREQUENCIES, U, np.zeros((len(FREQUENCIES), orders + 1, 0)))


def rows(model, theta):
    N = len(FREQUENCIES)
    return np.tile(model.parameters(theta), (N, 1)), np.tile(model.inner_constants(theta), (N, 1))


STIFF = {("quintic", 1), ("square", 4)}  # whose motion nine harmonics do not tell at 1 mm
OTHER_COUNTS = [("cubic", 1), ("coulomb", 1), *(each for each in IN_ROWS if each[1] != 2)]


@pytest.mark.parametrize(
    ("law", "count"),
    [*((law, 2) for law in LAWS), *(pytest.param(*each, marks=pytest.mark.long) for each in OTHER_COUNTS)],
)
def test_slopes_are_differences(law, count):
    model, theta = chain(law, count)
    drive = drive_of(9, 3e-4 if (law, count) in STIFF else 1e-3)
    at = periodic_response(model, *rows(model, theta), drive)
    assert np.all(at.converged)
    own = slopes(
        model,
        rows(model, theta)[0],
        drive,
        at,
        harmonic_unit_forces(model, drive, at),
        model.T,
        model.constants_map[0],
    )
    for j in range(len(theta)):
        step = 1e-5 * theta[j] * np.eye(len(theta))[j]
        ends = [periodic_response(model, *rows(model, theta + s * step), drive, at.delta) for s in (1, -1)]
        difference = (ends[0].X - ends[1].X) / (2 * np.sum(step))
        size = np.max(np.abs(own.X[..., j]))
        assert np.max(np.abs(difference - own.X[..., j])) <= 1e-6 * size, model.unknowns[j].name
        forces = [harmonic_unit_forces(model, drive, end) for end in ends]
        difference = (forces[0] - forces[1]) / (2 * np.sum(step))
        size = np.max(np.abs(own.unit_forces[..., j]), axis=(0, 1))
        away = np.max(np.abs(difference - own.unit_forces[..., j]), axis=(0, 1))
        assert np.all(away <= 1e-6 * size + 1e-7 * np.max(size)), model.unknowns[j].name


def test_slopes_along_inputs_are_differences():
    model, theta = two_masses("cubic")
    drive = drive_of(7)
    p, constants = rows(model, theta)
    at = periodic_response(model, p, constants, drive)
    along = np.zeros((1, 8, 1, 2), dtype=complex)
    along[0, 1, 0, 0], along[0, 3, 0, 1] = 1.0, 1j
    zero = np.zeros((len(model.elements), 2))
    own = slopes(
        model,
        p,
        drive,
        at,
        harmonic_unit_forces(model, drive, at),
        zero,
        np.zeros((0, 2)),
        along,
        np.zeros((1, 8, 0, 2)),
    )
    for j in range(2):
        ends = [
            periodic_response(
                model, p, constants, Drive(drive.omega, drive.U + s * 1e-8 * along[..., j], drive.f), at.delta
            ).X
            for s in (1, -1)
        ]
        difference = (ends[0] - ends[1]) / 2e-8
        assert np.max(np.abs(difference - own.X[..., j])) <= 1e-6 * np.max(np.abs(own.X[..., j]))


@pytest.mark.parametrize("law", ["cubic", "v**3", "d**3 + b*d**2"])
def test_the_motion_satisfies_its_equation_at_every_instant(law):
    model, theta = two_masses(law)
    drive = drive_of(31)
    p, constants = rows(model, theta)
    at = periodic_response(model, p, constants, drive)
    assert np.max(truncation(model, p, constants, drive, at)) < 1e-9
    there, _, _ = period_basis(31, 256)
    forces = p[:, None] * harmonic_unit_forces(model, drive, at)
    net = forces @ model.B  # (N, H + 1, n): what is left over of all forces
    real = np.concatenate(
        [net[:, :1].real, np.stack([net[:, 1:].real, net[:, 1:].imag], 2).reshape(5, -1, 2)], 1
    )
    size = np.max(np.abs(forces))
    assert np.max(np.abs(there @ real)) < 1e-9 * size


def test_without_its_nonlinear_part_the_rig_is_linear():
    model, theta = two_masses("cubic")
    weak = theta.copy()
    weak[5] = 0.0
    drive = drive_of(3)
    at = periodic_response(model, *rows(model, weak), drive)
    linear = response(
        Model(model.coordinates, model.inputs, model.elements[:-1]),
        model.parameters(weak)[:-1], drive.omega, drive.U[:, 1],
    )  # fmt: skip
    assert np.allclose(at.X[:, 1], linear, rtol=1e-12)
    assert np.max(np.abs(at.X[:, 3])) == 0


def duffing():
    """One mass on a linear and a cubic spring, pushed."""
    law = force_law("cubic")
    spring = between("k3", Kind.SPRING, "x", "ground")
    return network(
        "x", "f@x", "m@x k:x-ground c:x-ground", type(spring)("k3", Kind.SPRING, spring.along, force_law=law)
    )


def test_duffings_first_harmonic_is_that_of_the_textbook():
    """One harmonic: (k − m ω² + 3/4 k₃ a²)² a² + (c ω a)² = f² (Nayfeh and Mook 1979, eq. 4.1.19)."""
    model = duffing()
    omega = np.array([0.5, 1.0, 1.3, 2.0])
    f = np.zeros((4, 2, 1), dtype=complex)
    f[:, 1] = 0.3
    drive = Drive(omega, np.zeros((4, 2, 0), dtype=complex), f)
    p = np.tile([1.0, 1.0, 0.2, 0.5], (4, 1))
    at = periodic_response(model, p, np.zeros((4, 0)), drive)
    a = np.abs(at.X[:, 1, 0])
    assert np.all(at.converged)
    assert np.allclose((1 - omega**2 + 0.375 * a**2) ** 2 * a**2 + (0.2 * omega * a) ** 2, 0.09, rtol=1e-10)


def test_the_start_chooses_the_branch_above_a_fold():
    model = duffing()
    drive = Drive(np.array([2.0]), np.zeros((1, 4, 0), dtype=complex), np.zeros((1, 4, 1), dtype=complex))
    drive.f[0, 1, 0] = 0.5
    p, nothing = np.array([[1.0, 1.0, 0.05, 1.0]]), np.zeros((1, 0))
    low, high = np.zeros((1, 1, 7)), np.zeros((1, 1, 7))
    low[0, 0, 1], high[0, 0, 2] = -0.15, -2.1
    ends = [np.abs(periodic_response(model, p, nothing, drive, start).X[0, 1, 0]) for start in (low, high)]
    assert ends[0] < 0.3
    assert ends[1] > 1.5
