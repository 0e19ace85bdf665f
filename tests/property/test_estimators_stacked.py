"""ls and iv against the paper's stacked formulas, written out sample by sample (Yamane 1989, eq. 4-20)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dashpot.arrays import Complex, Real
from dashpot.channel import Quantity
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record
from dashpot.estimate.identify import identify
from dashpot.estimate.linear.instrumental_variables import InstrumentalVariables
from dashpot.estimate.linear.least_squares import LeastSquares
from dashpot.model.elements import Kind
from tests.rigs import Rig, channels, paper_rig, random_rig, records

D, V, A = Quantity.DISPLACEMENT, Quantity.VELOCITY, Quantity.ACCELERATION
KINDS = frozenset({Kind.SPRING, Kind.DAMPER, Kind.MASS, Kind.INERTER})


@dataclass
class Stacked:
    """The paper's matrices of one rig.  Inerters that hang on an input add ü to ū = (u̇, u); forces go to the right.

    Unknowns of a tied parameter are one column of p = T θ + p⁰ (eq. 12).
    """

    rig: Rig

    def __post_init__(self) -> None:
        model = self.rig.model
        x, u = list(model.coordinates), list(model.displacement_inputs)
        n, r = len(x), len(u)
        self.n, self.r = n, r
        block = {Kind.MASS: 0, Kind.INERTER: 0, Kind.DAMPER: 1, Kind.SPRING: 2}
        driven = {Kind.DAMPER: 0, Kind.SPRING: 1, Kind.INERTER: 2, Kind.MASS: 2}
        self.Q, self.R = [], []
        for element in model.elements:
            Q, R = np.zeros((n, 3 * n)), np.zeros((n, 3 * r))  # eq. 6, [M C K] and [F G J]
            for one, b in element.along.items():
                if one not in x:
                    continue
                for other, factor in element.along.items():
                    if other in x:
                        Q[x.index(one), block[element.kind] * n + x.index(other)] += b * factor
                    else:
                        R[x.index(one), driven[element.kind] * r + u.index(other)] -= b * factor
            self.Q.append(Q)
            self.R.append(R)

    def J(self, omega: float) -> Real:
        """Eq. 4."""
        identity, zero = np.eye(self.n), np.zeros((self.n, self.n))
        return np.block([[-(omega**2) * identity, zero], [zero, identity], [identity, zero]])

    def columns(self, state: Real, u_bar: Real, omega: float) -> Real:
        """A(t) = [a_1 … a_Np] of one sample, a_i = Q_i J z − R_i ū (eq. 9), (n, elements)."""
        J = self.J(omega)
        return np.stack([Q @ J @ state - R @ u_bar for Q, R in zip(self.Q, self.R, strict=True)], axis=1)

    def unknown_side(self, A: Real) -> tuple[Real, Real]:
        """(A_u, −A_k p_k) of eq. 12."""
        model = self.rig.model
        return A @ model.T, -A @ model.p0

    def inputs(self, line: int, t: float) -> Real:
        """ū(t) = (u̇, u, ü), known functions of time."""
        omega = self.rig.omega[line]
        U = self.rig.U[line]
        e = np.exp(1j * omega * t)
        return np.concatenate([(1j * omega * U * e).real, (U * e).real, (-(omega**2) * U * e).real])

    def forces(self, line: int, t: float) -> Real:
        return self.rig.model.S @ (self.rig.f[line] * np.exp(1j * self.rig.omega[line] * t)).real

    def stack(self, dwells: Sequence[Record], auxiliary: Complex | None = None) -> tuple[Real, Real]:
        """(Ā, h̄) of eq. 14 from the samples; from the auxiliary model's response (lines, n) instead: W̄ (eq. 19)."""
        left, right = [], []
        for line, dwell in enumerate(dwells):
            omega = float(self.rig.omega[line])
            column = {(c.quantity, next(iter(c.of))): i for i, c in enumerate(dwell.channels)}
            for t, row in zip(dwell.time, dwell.values, strict=True):
                if auxiliary is None:
                    state = np.array([row[column[q, x]] for q in (D, V) for x in self.rig.model.coordinates])
                else:
                    X = auxiliary[line] * np.exp(1j * omega * t)
                    state = np.concatenate([X.real, (1j * omega * X).real])
                A_u, h = self.unknown_side(self.columns(state, self.inputs(line, t), omega))
                left.append(A_u)
                right.append(h + self.forces(line, t))
        return np.concatenate(left), np.concatenate(right)

    def response(self, theta: Real) -> Complex:
        """Steady response of the auxiliary model (eq. 18), (lines, n)."""
        p = self.rig.model.parameters(theta)
        MCK = sum(p_i * Q for p_i, Q in zip(p, self.Q, strict=True))
        FGJ = sum(p_i * R for p_i, R in zip(p, self.R, strict=True))
        n, r = self.n, self.r
        M, C, K = MCK[:, :n], MCK[:, n : 2 * n], MCK[:, 2 * n :]
        F, G, J = FGJ[:, :r], FGJ[:, r : 2 * r], FGJ[:, 2 * r :]
        rows = []
        for omega, U, f in zip(self.rig.omega, self.rig.U, self.rig.f, strict=True):
            force = (1j * omega * F + G - omega**2 * J) @ U + self.rig.model.S @ f
            rows.append(np.linalg.solve(-(omega**2) * M + 1j * omega * C + K, force))
        return np.array(rows)


def stacked_ls(rig: Rig, dwells: Sequence[Record]) -> Real:
    """Eq. 17 with Q = I, solved by QR: no normal matrix is formed."""
    A, h = Stacked(rig).stack(dwells)
    size = np.linalg.norm(A, axis=0)
    return np.linalg.lstsq(A / size, h, rcond=None)[0] / size


def stacked_iv(rig: Rig, dwells: Sequence[Record], theta: Real, rounds: int = 60) -> Real:
    """Eq. 20 from `theta`, until nothing moves by more than 1e-12."""
    stacked = Stacked(rig)
    A, h = stacked.stack(dwells)
    for _ in range(rounds):
        W, _ = stacked.stack(dwells, stacked.response(theta))
        row, column = np.linalg.norm(W, axis=0), np.linalg.norm(A, axis=0)
        new = np.linalg.solve((W / row).T @ (A / column), (W / row).T @ h) / column
        moved = np.max(np.abs(new / theta - 1))
        theta = new
        if moved < 1e-12:
            break
    return theta


def assert_equal(rig: Rig, dwells: Sequence[Record], *, drift: int | None = None) -> None:
    data = spectrum(dwells, drift=drift, harmonics=(), noise="white", moments=True)
    ls = identify(rig.model, data, LeastSquares())
    slow = stacked_ls(rig, dwells)
    np.testing.assert_allclose(ls.values, slow, rtol=1e-9)
    iv = identify(rig.model, data, InstrumentalVariables(tolerance=1e-12))
    if iv.converged:  # the paper's iteration has no guard: a start that LS has spoilt may never settle
        np.testing.assert_allclose(iv.values, stacked_iv(rig, dwells, slow), rtol=1e-9)


@pytest.mark.slow
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(1, 5),
    inputs=st.sampled_from([(1, 0), (2, 0), (0, 1), (1, 1), (2, 1)]),
    same_phase=st.booleans(),
    periods=st.sampled_from([1.0, 2.0, 1.3, 2.71]),
    jitter=st.sampled_from([0.0, 0.6]),
    noise=st.sampled_from([0.002, 0.02]),
)
@settings(max_examples=20)
def test_random_networks(
    seed: int, n: int, inputs: tuple[int, int], same_phase: bool, periods: float, jitter: float, noise: float
) -> None:
    """Chains and meshes, whole and broken periods, even and uneven steps, channels in any order."""
    rng = np.random.default_rng(seed)
    rig = random_rig(
        rng, n, displacements=inputs[0], forces=inputs[1], kinds=KINDS, same_phase=same_phase, worst=200.0
    )
    seen = channels(rig, (D, V), rng)
    assert_equal(rig, records(rig, seen, rng, samples=14, periods=periods, relative=noise, jitter=jitter))


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.01, 0.35])
def test_the_papers_rig(noise: float) -> None:
    """CASE 3, 56 samples over one period of each line."""
    rng = np.random.default_rng(1989)
    rig = paper_rig()
    dwells = records(rig, channels(rig, (D, V), rng), rng, samples=56, relative=noise)
    assert_equal(rig, dwells)


def test_iv_settles_on_the_papers_rig() -> None:
    """So that the comparison above is not skipped where it matters."""
    rng = np.random.default_rng(1989)
    rig = paper_rig()
    for noise in (0.01, 0.1, 0.35):
        dwells = records(rig, channels(rig, (D, V)), rng, samples=56, relative=noise)
        data = spectrum(dwells, drift=None, harmonics=(), noise="white", moments=True)
        assert identify(rig.model, data, InstrumentalVariables(tolerance=1e-12)).converged


def test_measured_accelerations_take_the_place_of_J() -> None:
    """With accelerometers a mass's unit force is the measured ẍ, not −ω² x; the rest of the formulas stands."""

    class Measured(Stacked):
        def stack(self, dwells: Sequence[Record], auxiliary: Complex | None = None) -> tuple[Real, Real]:
            if auxiliary is not None:
                return super().stack(dwells, auxiliary)
            left, right = [], []
            for line, dwell in enumerate(dwells):
                column = {(c.quantity, next(iter(c.of))): i for i, c in enumerate(dwell.channels)}
                for t, row in zip(dwell.time, dwell.values, strict=True):
                    z = np.array([row[column[q, x]] for q in (A, V, D) for x in self.rig.model.coordinates])
                    u_bar = self.inputs(line, t)
                    columns = [Q @ z - R @ u_bar for Q, R in zip(self.Q, self.R, strict=True)]
                    A_u, h = self.unknown_side(np.stack(columns, axis=1))
                    left.append(A_u)
                    right.append(h + self.forces(line, t))
            return np.concatenate(left), np.concatenate(right)

    rng = np.random.default_rng(7)
    for n in (1, 2, 4):
        rig = random_rig(rng, n, forces=1, kinds=KINDS, worst=200.0)
        dwells = records(rig, channels(rig, (A, D, V), rng), rng, samples=20, periods=1.4, relative=0.02)
        data = spectrum(dwells, drift=None, harmonics=(), noise="white", moments=True)
        A_, h = Measured(rig).stack(dwells)
        size = np.linalg.norm(A_, axis=0)
        slow = np.linalg.lstsq(A_ / size, h, rcond=None)[0] / size
        np.testing.assert_allclose(identify(rig.model, data, LeastSquares()).values, slow, rtol=1e-9)
