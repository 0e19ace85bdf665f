"""The sums over the lines of whole records against their slow twin, `objective.predict`, which goes line by line."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from dashpot.arrays import Complex, Real
from dashpot.channel import Quantity
from dashpot.data.conditioning.whole_record import whole_record
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum, concatenate
from dashpot.estimate.likelihood import record_passes, record_sums
from dashpot.estimate.likelihood import record_passes as record_pieces
from dashpot.estimate.likelihood.measured import Measured
from dashpot.estimate.likelihood.objective import (
    directly_driven,
    local,
    measured,
    nuisance_columns,
    per_line,
    predict,
)
from dashpot.estimate.likelihood.record_sums import compiled_passes, shown_by_ends
from dashpot.estimate.preparation import prepare
from dashpot.model.observation import ObservationModel, observation_model
from dashpot.numerics.kernel import using
from tests.kernels import apart, compiled, instruction_sets, instructions
from tests.whole_rigs import WholeTest, chain, record_of, with_ends

TWINS = 1e-12


@dataclass(frozen=True)
class Case:
    """A likelihood at some ψ, away from its minimum."""

    view: ObservationModel
    data: Measured
    psi: Real
    sign: Real


def case(
    test: WholeTest,
    share: Real,
    *,
    joined: bool = False,
    unknown: bool = False,
    lines: Callable[[Record], Spectrum] = whole_record,
) -> Case:
    """The noise is `share` of each channel's size; `joined` correlates it, `unknown` are a gain and a delay."""
    rng = np.random.default_rng(3)
    sd = share * test.size
    record = test.noisy(rng, sd)
    if unknown:
        first, second, *others = record.channels
        record = replace(
            record, channels=(replace(first, gain=None), replace(second, delay=None, sign=None), *others)
        )
    spectrum = lines(record)
    root = np.diag(2 * sd / np.sqrt(len(record.time)))
    if joined:
        root = root @ (np.eye(len(sd)) + 0.3 * rng.normal(size=(len(sd), len(sd))))
    V = np.broadcast_to((root @ root.T).astype(complex), spectrum.covariance.shape)
    spectrum = replace(
        spectrum, covariance=V, noise=("given",) * spectrum.lines, dof=np.full(spectrum.lines, np.inf)
    )
    data = prepare(test.model, spectrum)
    view = observation_model(test.model, spectrum.channels, spectrum.omega)
    theta = test.theta * rng.uniform(0.8, 1.2, len(test.theta))
    psi = np.concatenate([theta, np.full(view.gains, 1.1), np.full(view.delays, 1e-3)])
    sign = np.where(view.flips, -1.0, 1.0)
    return Case(view, measured(data), np.stack([psi, 1.05 * psi]), np.stack([sign, np.ones_like(sign)]))


def exact_inputs(test: WholeTest, share: float = 0.05) -> Real:
    outputs = len(test.size) - len(test.model.inputs)
    return np.where(np.arange(len(test.size)) < outputs, share, 0.0)


def require_twins(given: Case) -> None:
    """NumPy's passes say what goes line by line says, and the kernel's say it to rounding."""
    with using("numpy"):
        require_as_line_by_line(given)
        twin = numbers_of(given)
    for name in instruction_sets():
        if not knows_records():
            continue
        with instructions(name), using("compiled"):
            fresh = replace(given, data=replace(given.data))
            assert compiled_passes(fresh.data.record_pieces, fresh.psi, fresh.sign) is not None
            require_ends_as_line_by_line(
                fresh, predict(given.view, given.data, given.psi, given.sign).at_ends
            )
            for values, expected in zip(numbers_of(fresh), twin, strict=True):
                assert apart(values, expected) < TWINS


def knows_records() -> bool:
    """Whether the kernel that is installed has passes over whole records."""
    try:
        return hasattr(compiled(), "Records")
    except pytest.skip.Exception:
        return False


def numbers_of(given: Case) -> tuple[Real, ...]:
    """What the passes say, in units in which the largest of each is about 1: K rows each."""
    sums = record_sums.record_sums(given.data.record_pieces, given.psi, given.sign)
    size = np.sqrt(np.diagonal(sums.information, axis1=1, axis2=2))
    both, root = size[:, :, None] * size[:, None, :], np.sqrt(sums.cost)
    information, scores, cost = record_sums.by_record_line(given.data.record_pieces, given.psi, given.sign)
    white, rank = record_sums.record_residuals(given.data.record_pieces, given.psi, given.sign)
    return (
        sums.cost[:, None], sums.gradient / size / root[:, None] + 1, sums.information / both,
        information / both[:, None], scores / size[:, None] / root[:, None, None] + 1, cost, np.abs(white),
        white.real + root[:, None, None], rank[:, None],
    )  # fmt: skip


def require_as_line_by_line(given: Case) -> None:
    slow = predict(given.view, given.data, given.psi, given.sign)
    K = len(given.psi)
    J, PJ, weighted = (
        part.reshape(K, -1, part.shape[-1]) for part in (slow.J, slow.PJ, slow.weighted[..., None])
    )
    information = 2 * (np.conj(np.swapaxes(J, 1, 2)) @ PJ).real
    gradient = 2 * (np.conj(np.swapaxes(J, 1, 2)) @ weighted).real[..., 0]
    cost = np.sum(slow.cost_per_line, axis=-1)
    size = np.sqrt(np.diagonal(information, axis1=1, axis2=2))
    found = local(given.view, given.data, given.psi, given.sign)
    np.testing.assert_allclose(found.cost, cost, rtol=1e-11)
    np.testing.assert_allclose(
        found.gradient / size, gradient / size, rtol=0, atol=1e-10 * np.sqrt(np.max(cost))
    )
    scale = size[:, :, None] * size[:, None, :]
    np.testing.assert_allclose(found.symmetric / scale, information / scale, rtol=0, atol=1e-10)
    of_lines, scores, costs = per_line(given.view, given.data, given.psi, given.sign)
    largest = np.max(np.abs(slow.information()) / scale[:, None])
    np.testing.assert_allclose(
        of_lines / scale[:, None], slow.information() / scale[:, None], rtol=0, atol=1e-9 * largest
    )
    np.testing.assert_allclose(
        np.sum(scores, axis=1) / size, gradient / size, rtol=0, atol=1e-9 * np.sqrt(np.max(cost))
    )
    np.testing.assert_allclose(costs, slow.cost_per_line, rtol=1e-9, atol=1e-9 * float(np.mean(costs)))
    assert nuisance_columns(given.view, given.data, given.psi, given.sign) == slow.columns
    white, _ = record_sums.record_residuals(given.data.record_pieces, given.psi, given.sign)
    np.testing.assert_allclose(2 * np.sum(np.abs(white) ** 2, axis=(1, 2)), cost, rtol=1e-11)
    require_ends_as_line_by_line(given, slow.at_ends)


def require_ends_as_line_by_line(given: Case, slow: Complex | None) -> None:
    assert slow is not None
    shown = shown_by_ends(given.data.record_pieces, given.psi, given.sign)
    size = np.max(np.abs(slow), axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(shown / size, slow / size, rtol=0, atol=1e-8)


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("noise", ["inputs exact", "inputs noisy", "correlated"])
def test_as_line_by_line(n: int, noise: str) -> None:
    model, theta = chain(n, 0.02, force=n == 2, seed=n)
    base = Quantity.ACCELERATION if n == 3 else Quantity.DISPLACEMENT
    test = record_of(model, theta, "random", decay_times=2, input_quantity=base, seed=n)
    share = exact_inputs(test) if noise == "inputs exact" else np.full(len(test.size), 0.05)
    require_twins(case(test, share, joined=noise == "correlated"))


@pytest.mark.parametrize("joined", [False, True])
def test_logarithms_as_line_by_line(joined: bool) -> None:
    """With slopes and without, under noise that channels share as well, which logarithms do not know."""
    model, theta = chain(2, 0.02, seed=2)
    test = record_of(model, theta, "random", decay_times=2, seed=2)
    given = case(test, exact_inputs(test), joined=joined)
    data = directly_driven(given.view, given.data)
    assert data is not None
    at = given.psi, given.sign, np.random.default_rng(1).random(data.y.shape[1:]) * (data.y[0] != 0)
    slow = predict(given.view, data, given.psi, given.sign)
    shown = np.where(data.y != 0, data.y - slow.r, 1.0)
    rho = np.log(np.where(data.y != 0, data.y, 1.0) / shown)
    stretch, J = np.sqrt(1 + np.abs(rho) ** 2 / 0.25), slow.J / shown[..., None]
    cost = np.sum(at[-1] * (stretch - 1), axis=(1, 2))
    gradient = 2 * np.einsum("klcm,klc->km", np.conj(J), at[-1] / stretch * rho).real
    found = local(given.view, data, *at)
    np.testing.assert_allclose(found.cost, cost, rtol=1e-9)
    np.testing.assert_allclose(found.gradient, gradient, rtol=0, atol=1e-7 * np.max(np.abs(gradient)))
    np.testing.assert_allclose(local(given.view, data, *at, slopes=False).cost, found.cost, rtol=1e-12)


def test_free_decay_and_unknown_calibrations() -> None:
    model, theta = chain(2, 0.02, base=False, seed=2)
    test = record_of(model, theta, "none", decay_times=2, seed=2)
    require_twins(case(test, exact_inputs(test)))
    model, theta = chain(2, 0.02, seed=2)
    driven = record_of(model, theta, "random", decay_times=2, seed=2)
    require_twins(case(driven, exact_inputs(driven), unknown=True))
    require_twins(case(driven, np.full(3, 0.05), unknown=True))


@pytest.mark.parametrize("exact", [True, False])
def test_many_records_whose_lines_stand_in_any_order(exact: bool) -> None:
    """Records with and without loads, with more and fewer polynomials, their lines shuffled."""
    model, theta = chain(2, 0.02, force=True, seed=2)
    test = record_of(model, theta, "random", decay_times=3, seed=2)

    def shuffled(record: Record) -> Spectrum:
        parts = []
        for k in range(4):
            first, last = k * len(record.time) // 4, (k + 1) * len(record.time) // 4
            part = replace(record, time=record.time[first:last], values=record.values[first:last])
            parts.append(with_ends(whole_record(part), polynomial=2 + k % 2, loads=k != 3))
        together = concatenate(parts)
        return together.select(np.random.default_rng(0).permutation(together.lines))

    require_twins(case(test, exact_inputs(test) if exact else np.full(len(test.size), 0.05), lines=shuffled))


def test_pieces_do_not_change_the_sums(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lines cut into many pieces that are made anew at each pass."""
    model, theta = chain(2, 0.02, seed=2)
    test = record_of(model, theta, "random", decay_times=2, seed=2)
    whole = case(test, exact_inputs(test))
    pieces = len(list(whole.data.record_pieces))
    monkeypatch.setattr(record_pieces, "NUMBERS", 2000)
    monkeypatch.setattr(record_pieces, "KEPT", 0)
    monkeypatch.setattr(record_passes, "KEPT", 0)
    cut = replace(whole, data=replace(whole.data))
    assert len(list(cut.data.record_pieces)) > 10 * pieces
    require_twins(cut)


def test_a_reaction_force_among_the_channels() -> None:
    from dashpot.channel import Channel

    model, theta = chain(2, 0.03, seed=2)
    test = record_of(model, theta, "random", decay_times=2, seed=2)
    p = model.parameters(theta)
    force = p[model_index(model, "k1")] * (test.record.values[:, 0] - test.record.values[:, -1])
    channels = (
        *test.record.channels[:-1],
        Channel("fk", {"k1": 1.0}, Quantity.FORCE),
        test.record.channels[-1],
    )
    values = np.column_stack([test.record.values[:, :-1], force, test.record.values[:, -1]])
    with_force = replace(test, record=replace(test.record, channels=channels, values=values))
    require_twins(case(with_force, exact_inputs(with_force)))
    require_twins(case(with_force, np.full(4, 0.05)))


def model_index(model: object, name: str) -> int:
    names = [element.name for element in model.elements]  # type: ignore[attr-defined]
    return names.index(name)


def test_an_input_that_nobody_sees_is_left_out() -> None:
    """Where two inputs reach the channels alike, one of them is all that can be estimated."""
    from dashpot.estimate.likelihood.record_passes import EstimatedInputs, columns_times

    rng = np.random.default_rng(1)
    G = rng.normal(size=(1, 3, 2, 5)) + 1j * rng.normal(size=(1, 3, 2, 5))
    G[:, :, 1, 2] = 2 * G[:, :, 0, 2]
    q = rng.normal(size=(1, 2, 1, 5)) + 0j
    data = columns_times(G, q)
    inputs = EstimatedInputs.of(G, data)
    found = inputs.amplitudes(np.zeros((1, 0, 5)))
    seen = np.arange(5) != 2
    np.testing.assert_allclose(found[0][:, seen], q[0, :, 0][:, seen], rtol=1e-10)
    assert found[0, 1, 2] == 0
    np.testing.assert_allclose(columns_times(G, found[:, :, None]), data, rtol=1e-10)
