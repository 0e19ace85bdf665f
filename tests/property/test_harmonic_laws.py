"""Laws of harmonic regression: what must hold for any record."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dashpot.channel import Channel
from dashpot.data.conditioning.harmonic_fit import fit_harmonics
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record

CHANNELS = tuple(Channel(name, {name: 1.0}) for name in ("x1", "x2", "u"))


@st.composite
def records(draw):
    """Records of 30 to 200 samples and 2 to 12 periods, uniform or not, white or coloured noise."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    samples = draw(st.integers(30, 200))
    f = draw(st.floats(0.1, 100))
    periods = draw(st.floats(2, min(12.0, samples / 6)))
    phase = np.linspace(0, 1, samples)
    if draw(st.booleans()):
        phase = np.sort(phase + rng.uniform(-0.4, 0.4, samples) / samples)
    t = draw(st.floats(-3, 3)) + phase * periods / f
    X = rng.normal(size=3) + 1j * rng.normal(size=3)
    noise = rng.normal(size=(samples, 3))
    if draw(st.booleans()):
        noise = np.cumsum(noise, axis=0) / 3
    y = np.real(np.exp(2j * np.pi * f * t)[:, None] * X) + draw(st.sampled_from([1e-3, 0.1, 1.0])) * noise
    return Record(CHANNELS, t, y, f, draw(st.integers(0, 3)))


def same(a, b):
    assert (a.channels, a.noise) == (b.channels, b.noise)
    for name in ("frequency_hz", "amplitudes", "covariance", "samples", "dof", "experiment"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


@settings(max_examples=30)
@given(st.lists(records(), min_size=2, max_size=4), st.data(), st.booleans())
def test_spectra_of_settled_records_add(many, data, moments):
    """As long as nothing is decided by all dwells together."""
    cut = data.draw(st.integers(1, len(many) - 1))
    each = {"moments": moments, "transients": "none", "refine": "none", "drift": 1, "noise": "own"}
    whole = spectrum(many, **each)
    parts = spectrum(many[:cut], **each) + spectrum(many[cut:], **each)
    same(whole, parts)
    if moments:
        np.testing.assert_array_equal(whole.moments.products, parts.moments.products)


@settings(max_examples=30)
@given(records(), st.floats(-10, 10))
def test_a_later_clock_turns_the_amplitudes(record, shift):
    here = fit_harmonics(record)
    there = fit_harmonics(Record(CHANNELS, record.time + shift, record.values, record.frequency_hz))
    assert here.orders == there.orders
    turn = np.exp(-2j * np.pi * record.frequency_hz * shift * np.array(here.orders))[:, None]
    size = np.max(np.abs(here.amplitudes))
    np.testing.assert_allclose(there.amplitudes, here.amplitudes * turn, atol=1e-9 * size)
    np.testing.assert_allclose(
        there.covariance, here.covariance, rtol=1e-6, atol=1e-9 * np.max(np.abs(here.covariance))
    )


@settings(max_examples=30)
@given(records(), st.permutations([0, 1, 2]), st.lists(st.floats(1e-3, 1e3), min_size=3, max_size=3))
def test_channels_may_be_permuted_and_scaled(record, order, factors):
    scale = np.array(factors)
    here = fit_harmonics(record)
    there = fit_harmonics(Record(CHANNELS, record.time, record.values[:, order] * scale, record.frequency_hz))
    assert (here.orders, here.noise) == (there.orders, there.noise)
    np.testing.assert_allclose(there.amplitudes, here.amplitudes[:, order] * scale, rtol=1e-8, atol=1e-10)
    expected = here.covariance[:, order][:, :, order] * np.multiply.outer(scale, scale)
    np.testing.assert_allclose(
        there.covariance / np.multiply.outer(scale, scale),
        expected / np.multiply.outer(scale, scale),
        rtol=1e-7,
        atol=1e-12,
    )


@settings(max_examples=30)
@given(records(), st.floats(-100, 100), st.floats(-10, 10))
def test_offset_and_drift_do_not_matter(record, offset, drift):
    here = fit_harmonics(record, harmonics=(), noise="white")
    trend = offset + drift * (record.time - record.time[0])[:, None] * record.frequency_hz
    there = fit_harmonics(
        Record(CHANNELS, record.time, record.values + trend, record.frequency_hz), harmonics=(), noise="white"
    )
    np.testing.assert_allclose(there.amplitudes, here.amplitudes, atol=1e-10)
    np.testing.assert_allclose(there.covariance, here.covariance, rtol=1e-6, atol=1e-12)


@settings(max_examples=30)
@given(records())
def test_covariance_is_hermitian_and_not_negative(record):
    V = fit_harmonics(record).covariance
    np.testing.assert_allclose(V, np.conj(np.swapaxes(V, -1, -2)))
    assert np.all(np.linalg.eigvalsh(V) > -1e-12 * np.max(np.abs(V)))
