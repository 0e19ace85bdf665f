"""Sums of even samples against waves: the compiled pass, its twin, and the Gram in closed form."""

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.data.conditioning.regression import CHUNK, Terms, solve_harmonics, window
from dashpot.data.record import Record
from dashpot.numerics.harmonic_sums import even_gram, harmonic_sums
from dashpot.numerics.kernel import using
from tests.kernels import compiled, instruction_sets, instructions


@pytest.mark.parametrize("name", instruction_sets())
@pytest.mark.parametrize(("samples", "channels"), [(1, 1), (37, 3), (70_001, 4)])
def test_the_compiled_pass_is_its_twin(samples: int, channels: int, name: str) -> None:
    rng = np.random.default_rng(samples)
    values, turns = 5 + rng.standard_normal((samples, channels)), np.array([0.0123, 0.0246, 0.3])
    with using("numpy"):
        twin = harmonic_sums(values, turns)
    with instructions(name):
        found = harmonic_sums(values, turns)
    size = np.sum(np.abs(values), axis=0)
    assert np.max(np.abs(found.waves - twin.waves) / size) < 1e-12
    assert np.max(np.abs(found.plain - twin.plain) / size) < 1e-12
    assert np.max(np.abs(found.moment - twin.moment) / (size * samples)) < 1e-12
    np.testing.assert_array_equal(found.largest, twin.largest)


def test_threads_do_not_change_a_bit() -> None:
    core = compiled()
    values, turns = np.random.default_rng(1).standard_normal((200_000, 2)), np.array([0.01])
    for one, three in zip(
        core.harmonic_sums(values, turns, 0.0, 1), core.harmonic_sums(values, turns, 0.0, 3), strict=True
    ):
        np.testing.assert_array_equal(one, three)


@pytest.mark.parametrize("degree", [-1, 0, 1])
def test_the_gram_in_closed_form_is_that_of_the_columns(degree: int) -> None:
    rate, f, samples, orders = 100.0, 1.37, 1003, (1, 2, 5)
    time = 0.8 + np.arange(samples) / rate
    centre, half = window(time)
    A = Terms(degree, tuple(orders)).columns(time, f, centre, half)
    gram = even_gram(samples, f / rate, 2 * np.pi * f * centre, orders, degree)
    assert gram is not None
    np.testing.assert_allclose(gram, A.T @ A, atol=1e-10 * samples)


def test_waves_that_alias_to_a_constant_have_no_closed_form() -> None:
    assert even_gram(1000, 0.5, 0.0, (1, 2), 0) is None


@pytest.mark.parametrize("degree", [0, 1])
def test_a_long_record_has_the_same_harmonics_either_way(degree: int) -> None:
    compiled()
    rng = np.random.default_rng(2)
    time = 3.0 + np.arange(CHUNK + 5000) / 500
    values = np.stack([np.cos(2 * np.pi * 7.1 * time), 2 + 0.1 * time], axis=-1)
    record = Record(
        (Channel("a", {"x": 1.0}), Channel("b", {"x": 1.0})), time, values + rng.normal(size=values.shape)
    )
    with using("numpy"):
        twin = solve_harmonics(record, 7.1, Terms(degree, (1, 2)))
    found = solve_harmonics(record, 7.1, Terms(degree, (1, 2)))
    np.testing.assert_allclose(found.coefficients, twin.coefficients, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(found.P, twin.P, rtol=1e-10, atol=1e-16)
    np.testing.assert_array_equal(found.largest, twin.largest)
