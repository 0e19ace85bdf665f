"""Files of an analyser that hold one frequency response each: "Frequency Magnitude Phase", and perhaps the coherence.

Their columns name no channels; the name of the file does, output before input: H_a1_f.csv is that of a1 to f.  Files
of one input and the same frequencies are joined; several of one response are repeats (taps of a hammer, say), whose
scatter is the noise.  With the ordinary coherence γ² of n averages the real and the imaginary part of H have the
variance |H|² (1 − γ²)/(2 n γ²) each (Bendat and Piersol 2010, chapter 9); without n its size is that of the scatter
of neighbouring lines, and γ² tells how it runs.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.channel import Channel, Quantity
from dashpot.data.noise import moderated
from dashpot.data.readers.amplitudes import (
    AmplitudeColumns,
    frequency_at,
    phase_factor,
    phase_notices,
    required,
)
from dashpot.data.readers.columns import Columns, bare, frequency_column, frequency_scale
from dashpot.data.readers.records import check_frequency
from dashpot.data.record import calibrated
from dashpot.data.spectrum import SettledDwell, Spectrum, concatenate
from dashpot.errors import DataError
from dashpot.io.words import listed
from dashpot.notices import Notice

_POLAR = (
    ("magnitude", "mag", "amplitude", "amp", "abs", "gain", "|h|", "betrag"),
    ("phase", "ph", "arg", "angle", "phase_deg", "phase_rad"),
)
_PARTS = (
    ("real", "re", "real part", "h_re", "realteil"),
    ("imag", "im", "imaginary", "imaginary part", "h_im"),
)
_COHERENCE = ("coherence", "coh", "gamma2", "kohärenz")
_AVERAGES = ("averages", "n_avg", "navg")
Pair = tuple[str, str]  # output, input
_NO_CHANNEL = re.compile(r"\d+(hz)?|(h|frf|tf|tap|hit|test|run|avg|mean|resp|response|mag|phase)\d*")


@dataclass(frozen=True)
class Response:
    """One response: output and input, its lines in the channels' own units, and of a coherence the variance, else NaN.

    frequency_hz (lines,); H (lines,) complex; variance (lines,) of the real and the imaginary part each.
    """

    pair: Pair
    source: str
    frequency_hz: Real
    H: Complex
    variance: Real


def is_response(columns: Columns) -> bool:
    """Whether the columns are those of a response without names: a frequency, and magnitude and phase or both parts."""
    return _places(columns) is not None


def _places(columns: Columns) -> tuple[int, int, int, bool] | None:
    """Columns of the frequency and of the two parts, and whether these are magnitude and phase."""
    names = [bare(name)[0].strip().lower() for name in columns.header]

    def only(words: Sequence[str]) -> int | None:
        at = [i for i, name in enumerate(names) if name in words]
        return at[0] if len(at) == 1 else None

    at = frequency_column(columns, ())
    frequency = only(("f", "hz")) if at is None else at
    for polar, (one, other) in ((True, _POLAR), (False, _PARTS)):
        first, second = only(one), only(other)
        if frequency is not None and first is not None and second is not None:
            return frequency, first, second, polar
    return None


def response_named(columns: Columns) -> tuple[tuple[str, str], str | None]:
    """Output and input of the only response of a file, by its name without a rig, and the unit of the response.

    They are the last two words of the name that may be channels; what it does not say is called response and force.
    """
    places = _places(columns)
    assert places is not None
    words = re.split(r"[\W_]+", Path(re.sub(r"(?i)\.gz$", "", columns.source)).stem)
    named = [word for word in dict.fromkeys(words) if word and not _NO_CHANNEL.fullmatch(word.lower())]
    if len(named) < 2:
        named = ["response" if named in ([], ["force"]) else named[0], "force"]
    return (named[-2], named[-1]), columns.unit(places[1])


def read_response(columns: Columns, channels: Sequence[Channel]) -> tuple[Response, list[Notice]]:
    """The response in a file.  Raises DataError if nothing says whose it is, or a number cannot be meant."""
    places = _places(columns)
    assert places is not None
    frequency_at, first, second, polar = places
    stem = Path(columns.source).name.lower()
    at = []
    for channel in channels:
        match = re.search(rf"(?<![a-z0-9]){re.escape(channel.name.lower())}(?![a-z0-9])", stem)
        if match:
            at.append((match.start(), channel))
    named = [channel for _, channel in sorted(at, key=lambda place: place[0])]
    forces = [channel for channel in channels if channel.quantity is Quantity.FORCE]
    if len(named) == 1:
        others = [c for c in (forces if named[0] not in forces else channels) if c not in named]
        named += others if len(others) == 1 else []
    elif not named and len(channels) == 2 and len(forces) == 1:
        named = [next(c for c in channels if c not in forces), *forces]
    if len(named) != 2:
        what = f"cannot tell which response this is, of {listed([c.name for c in channels])}"
        like = "_".join(
            c.name for c in (next((c for c in channels if c not in forces), channels[0]), *forces[:1])
        )
        cure = f"let the file's name hold those of output and input, such as H_{like}.csv, or rename the channels"
        raise DataError(what, columns.source, cure)
    pair = named[0].name, named[1].name
    names = [bare(name)[0].strip().lower() for name in columns.header]
    more = {i: names[i] for i in range(len(names)) if names[i] in (*_COHERENCE, *_AVERAGES)}
    values = columns.numbers([frequency_at, first, second, *more])
    frequency = values[frequency_at] * frequency_scale(columns, frequency_at)
    check_frequency(columns, frequency_at, frequency)
    notes = list(columns.notes)
    decibel = polar and (columns.unit(first) or "").lower() == "db"
    if polar and not decibel and np.any(values[first] < 0):
        decibel = True
        what = f"{columns.source}: magnitudes below zero are read as dB, 20 log10 of the channels' units"
        notes.append(Notice("magnitude_in_db", what, pair))
    both = AmplitudeColumns(first, second, phase_factor(columns, second) if polar else None, decibel)
    if polar:
        notes += phase_notices(columns, {"/".join(pair): both}, frequency)
    H = both.of(values) * columns.scale_of_response(first, *named)
    variance = np.full(len(frequency), np.nan)
    coherence = [i for i, name in more.items() if name in _COHERENCE]
    if coherence:
        averages = next((values[i] for i, name in more.items() if name in _AVERAGES), None)
        variance, said = _by_coherence(columns, coherence[0], values, H, averages, pair)
        notes += said
    return Response(pair, columns.source, frequency, H, variance), notes


# Tables of frequency response functions as CSV: `frequency_hz`, then `OUT/IN_re`, `OUT/IN_im`, optionally
# `OUT/IN_sd`.
#
# OUT and IN are channels of the rig file, in their units; `OUT/IN_sd` is the standard deviation of the real
# and of the imaginary part, each, `OUT/IN_coherence` tells it where there is none; `A/IN&B/IN_cov_re`, `…_cov_im`
# the covariance E[Δ_A conj(Δ_B)]. Every input makes an experiment of its own, driven with amplitude 1 at IN and 0 at
# the others, which are exact.


def read_frf(
    columns: Columns, found: Mapping[str, AmplitudeColumns], channels: Sequence[Channel], experiment: int = 0
) -> tuple[Spectrum, list[Notice]]:
    """The spectrum in SI units, one experiment for each input from number `experiment` on, and notes.

    `found` are the amplitude columns.  Without any sd or coherence the noise is unknown; else what has none is exact.
    Raises DataError with file and column for what is missing, not a number, or not in the rig file.
    """
    at = {pair: required(columns, found, "/".join(pair)) for pair in _pairs(columns, found, channels)}
    sd_at, coherence_at = (
        {pair: i for pair in at if (i := columns.find("/".join(pair) + ending)) is not None}
        for ending in ("_sd", "_coherence")
    )
    coherence_at = {} if sd_at else coherence_at
    f_at, notes = frequency_at(columns, channels), list(columns.notes)
    together = {
        (one[0], other[0], one[1]): required(columns, found, stem)
        for one in sd_at
        for other in sd_at
        if one[1] == other[1] and (stem := f"{'/'.join(one)}&{'/'.join(other)}_cov") in found
    }
    of_pairs = (i for both in (*at.values(), *together.values()) for i in (both.first, both.second))
    values = columns.numbers(list(dict.fromkeys([f_at, *of_pairs, *sd_at.values(), *coherence_at.values()])))
    frequency = values[f_at] * frequency_scale(columns, f_at)
    check_frequency(columns, f_at, frequency)
    responses, by_name = [], {channel.name: channel for channel in channels}
    factor = {
        pair: columns.scale_of_response(both.first, *(by_name[name] for name in pair))
        for pair, both in at.items()
    }
    for pair, both in at.items():
        H = both.of(values) * factor[pair]
        variance = np.full(len(frequency), 0.0 if sd_at or coherence_at else np.nan)
        if pair in sd_at:
            sd = values[sd_at[pair]]
            columns.refuse(sd_at[pair], sd < 0, "a standard deviation of {:g}", "0 means exact", sd)
            variance = (sd * factor[pair]) ** 2
        elif pair in coherence_at:
            variance, said = _by_coherence(columns, coherence_at[pair], values, H, None, pair)
            notes += said
        responses.append(Response(pair, columns.source, frequency, H, variance))
    shared = {
        three: both.of(values) * factor[three[0], three[2]] * factor[three[1], three[2]]
        for three, both in together.items()
    }
    return concatenate(list(joined_responses(responses, channels, experiment, shared))), notes


def _by_coherence(
    columns: Columns, at: int, values: Mapping[int, Real], H: Complex, averages: Real | None, pair: Pair
) -> tuple[Real, list[Notice]]:
    """The variance of a response by the coherence in column `at`, and notes.  Raises DataError if it is none."""
    gamma2 = values[at]
    columns.refuse(at, (gamma2 < 0) | (gamma2 > 1.001), "a coherence of {:g}", "it is 0 to 1", gamma2)
    variance, said = coherent_variance(H, gamma2, averages)
    text = f"{columns.source}: {'/'.join(pair)}: {said}"
    return variance, [Notice("averages_unknown", text, pair)] if said else []


def coherent_variance(H: Complex, gamma2: Real, averages: Real | None) -> tuple[Real, str]:
    """The variance of real and imaginary part of H (lines,) by its coherence, and what is to be said of it.

    Where the number of averages is not known, the size is that of second differences of neighbouring lines, which bends
    of H only make larger, and one average at most.
    """
    trusted = np.clip(gamma2, 1e-6, 1 - 1e-9)
    once = np.abs(H) ** 2 * (1 - trusted) / (2 * trusted)
    if averages is not None:
        return once / np.maximum(averages, 1), ""
    share = 1.0
    if len(H) >= 8:
        bend = np.abs(H[:-2] - 2 * H[1:-1] + H[2:]) ** 2
        expected = 2 * (once[:-2] + 4 * once[1:-1] + once[2:])
        # The median of what is distributed as χ² of two degrees of freedom is ln 2 of its mean.
        share = min(float(np.median(bend / np.maximum(expected, 1e-300)) / np.log(2)), 1.0)
    text = (
        "the number of averages behind the coherence is not stated: the noise is estimated from the scatter of "
        f"neighbouring lines (about {1 / max(share, 1e-9):.2g} averages); add a column averages"
    )
    return share * once, text


def _pairs(
    columns: Columns, found: Mapping[str, AmplitudeColumns], channels: Sequence[Channel]
) -> list[Pair]:
    """Which response to which input there is.  Raises DataError if there is none, or one is missing."""
    names = {channel.name for channel in channels}
    pairs = []
    plain = (bare(column)[0] for column in columns.header)
    for stem in dict.fromkeys([*(name[:-3] for name in plain if name.endswith("_re")), *found]):
        out, _, into = stem.partition("/")
        if out in names and into in names:
            pairs.append((out, into))
    if not pairs:
        raise DataError(
            f"no column OUT/IN_re names two channels of the rig file ({listed(c.name for c in channels)})",
            columns.source,
            "name the columns after its channels",
        )
    inputs = {into for _, into in pairs}
    for into in inputs:
        for out in names - inputs:
            if (out, into) not in pairs:
                raise DataError(
                    f"there is no column {out}/{into}_re (the rig file lists the channels)",
                    columns.source,
                    "add it, or take the channel out of the rig file",
                )
    return pairs


def joined_responses(
    responses: Sequence[Response],
    channels: Sequence[Channel],
    experiment: int,
    shared: Mapping[tuple[str, str, str], Complex] = MappingProxyType({}),
) -> Iterator[Spectrum]:
    """The spectra of responses in SI units, one for each input and its frequencies, numbered from `experiment` on.

    shared: E[Δ_A conj(Δ_B)] (lines,) of the noise that two outputs A, B share in their responses to an input.
    Channels that were not measured with an input are NaN.  Raises DataError as `calibrated`.
    """
    groups: dict[tuple[str, bytes], list[Response]] = {}
    for each in responses:
        first = each.frequency_hz[:1]
        key = np.round(each.frequency_hz / first, 6).tobytes() + b"".join(b"%.6g" % f for f in first)
        groups.setdefault((each.pair[1], key), []).append(each)
    inputs = {each.pair[1] for each in responses}
    forces = {channel.name for channel in channels if channel.quantity is Quantity.FORCE}
    if (
        inputs & forces
    ):  # what is pushed somewhere is not pushed elsewhere; a force on a moved base is none that drives
        inputs |= forces
    scale, names = np.array([channel.scale for channel in channels]), [channel.name for channel in channels]
    for number, group in enumerate(groups.values()):
        into, frequency = group[0].pair[1], group[0].frequency_hz
        lines = len(frequency)
        X = np.full((lines, len(channels)), np.nan, dtype=np.complex128)
        V = np.zeros((lines, len(channels), len(channels)), dtype=np.complex128)
        dof, kinds = np.inf, set[str]()
        for c, channel in enumerate(channels):
            repeats = [each for each in group if each.pair[0] == channel.name]
            if repeats:
                X[:, c], variance, of = _averaged(repeats)
                V[:, c, c] = 2 * variance
                dof = min(dof, of)
                kinds.add(
                    "periods" if np.isfinite(of) else "given" if np.all(np.isfinite(variance)) else "unknown"
                )
            elif channel.name in inputs:
                X[:, c] = float(channel.name == into)
            else:
                V[:, c, c] = np.nan
        for (one, other, of_input), covariance in shared.items():
            if of_input == into:
                c, d = names.index(one), names.index(other)
                V[:, c, d], V[:, d, c] = covariance, np.conj(covariance)
        noise = "unknown" if "unknown" in kinds else "periods" if "periods" in kinds else "given"
        if noise == "unknown":
            V, dof = np.full_like(V, np.nan), np.inf
        joined = Spectrum(
            tuple(channels),
            frequency,
            *calibrated(channels, frequency, X * scale, V * np.outer(scale, scale)),
            np.ones(lines, dtype=np.int64),
            np.full(lines, dof),
            (noise,) * lines,
            np.full(lines, experiment + number),
            stretches=(SettledDwell(per_unit=True),),
        )
        yield moderated(joined, kind="periods")


def _averaged(repeats: Sequence[Response]) -> tuple[Complex, Real, float]:
    """Mean of responses, the variance of its parts (NaN: unknown) and the degrees of freedom behind that (inf: given).

    Weighted by their coherences where all have one; of several the scatter tells the noise.
    """
    H, variance = np.stack([each.H for each in repeats]), np.stack([each.variance for each in repeats])
    if len(repeats) == 1:
        return H[0], variance[0], np.inf
    weight = 1 / np.maximum(variance, 1e-300) if np.all(np.isfinite(variance)) else np.ones(variance.shape)
    weight = weight / np.sum(weight, axis=0)
    mean = np.sum(weight * H, axis=0)
    # Of a weight w the variance is σ²/w, of the mean σ².
    scatter = np.sum(weight * np.abs(H - mean) ** 2, axis=0) / (2 * (len(repeats) - 1))
    return mean, scatter, 2.0 * (len(repeats) - 1)
