"""Data files of a command: read, turned into amplitudes as the options say, and what was noticed on the way told."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import click

from dashpot.errors import UsageError, printable

if TYPE_CHECKING:
    from dashpot.data.conditioning.settings import Conditioning
    from dashpot.data.conditioning.used_dwells import UsedDwell
    from dashpot.data.readers import Reading
    from dashpot.data.spectrum import Spectrum
    from dashpot.model.rigfile import Rig
    from dashpot.notices import Notice

CONDITIONING = ("orders", "harmonics", "drift", "noise", "refine", "settle")


@dataclass(frozen=True)
class MeasuredData:
    """The amplitudes of data files, treatments of time records not chosen, and the dwells used, where asked for."""

    spectrum: Spectrum
    untried: tuple[str, ...]
    dwells: tuple[UsedDwell, ...] = ()


def read_files(rig: Rig, paths: Sequence[str], options: Mapping[str, Any], quiet: bool) -> Reading:
    """What data files hold, with what was noticed told.

    Raises DataError, and UsageError for a file given twice and for --frequency unused.
    """
    from dashpot.app.progress import progress
    from dashpot.data.readers import read

    require_each_once(paths)
    with progress(reading_of(paths), quiet):
        reading = read(paths, rig.channels, frequency_hz=options["frequency"])
    stated = options["frequency"]
    if stated is not None and not any(record.frequency_hz == stated for record in reading.records):
        cause = "--frequency is for records that name no drive frequency, and these data name theirs"
        raise UsageError(cause, cure="leave it out")
    tell_notes(reading.notes, quiet)
    return reading


def require_each_once(paths: Sequence[str]) -> None:
    """Raises UsageError where a file is named twice: its noise would count as that of two tests."""
    files = [os.path.realpath(path) for path in paths]
    for path, file in zip(paths, files, strict=True):
        if files.count(file) > 1:
            raise UsageError(
                f"{printable(path)} is given {files.count(file)} times: the same data are one test",
                cure="name each file once",
            )


def measured_data(
    rig: Rig,
    reading: Reading,
    options: Mapping[str, Any],
    quiet: bool,
    *,
    moments_for: Iterable[str] = (),
    part: tuple[float, float] = (0.0, 1.0),
    with_dwells: bool = False,
) -> MeasuredData:
    """The amplitudes of what was read, with the options of `conditioning_options` by name.

    Second moments of the samples are kept where one of the methods named by `moments_for` needs them and the files
    hold samples; unsettled dwells are cut to what has settled where one of them knows no transients.  `part` is the
    share of every record's samples that is used, from where to where; `with_dwells` keeps them, for pictures.
    Raises DataError.
    """
    from dashpot.app.progress import progress
    from dashpot.estimate.identify import amplitudes_for, conditioning_for
    from dashpot.estimate.registry import method_class

    traits = [method_class(name).traits for name in moments_for if name != "auto"]
    stated: dict[str, Any] = {
        name: value for name, value in reading.conditioning.items() if not _was_given(name)
    }
    conditioning = with_noise_record(replace(conditioning_from(options), **stated), rig, options, quiet)
    reading = part_of(reading, part)
    with progress("amplitudes", quiet):
        spectrum = amplitudes_for(rig.model, reading, conditioning, traits)
    if options.get("record_band") is not None and not spectrum.records:
        cause = "--band chooses frequencies of whole records, and these data hold dwells"
        raise UsageError(cause, cure="leave it out")
    tell_notes(spectrum.notes, quiet)
    dwells: tuple[UsedDwell, ...] = ()
    if with_dwells:
        from dashpot.data.conditioning.used_dwells import used_dwells

        treated = conditioning_for(rig.model, reading, conditioning, traits)
        dwells = used_dwells(reading.records, spectrum, treated)
    return MeasuredData(spectrum, conditioning.untried if reading.records else (), dwells)


def read_spectrum(
    rig: Rig,
    paths: Sequence[str],
    options: Mapping[str, Any],
    quiet: bool,
    *,
    moments_for: Iterable[str] = (),
    part: tuple[float, float] = (0.0, 1.0),
) -> Spectrum:
    """The amplitudes of data files alone, as `measured_data` makes them."""
    reading = read_files(rig, paths, options, quiet)
    return measured_data(rig, reading, options, quiet, moments_for=moments_for, part=part).spectrum


def with_noise_record(
    conditioning: Conditioning, rig: Rig, options: Mapping[str, Any], quiet: bool
) -> Conditioning:
    """With the noise that the file of --noise-record shows, where there is one.  Raises DataError."""
    if not options.get("noise_record"):
        return conditioning
    from dashpot.data.conditioning.still import noise_at_rest
    from dashpot.data.readers import read

    still = read(options["noise_record"], rig.channels)
    tell_notes(still.notes, quiet)
    return conditioning.changed(still=noise_at_rest(still.records))


def reading_of(paths: Sequence[str]) -> str:
    """What is being read, in a few words."""
    name = printable(os.path.basename(paths[0]))
    return f"reading {name[:40]}" + (f" and {len(paths) - 1} more" if len(paths) > 1 else "")


def part_of(reading: Reading, part: tuple[float, float]) -> Reading:
    """The same with the share `part` of every record's samples.  Raises DataError where there are none."""
    if part == (0.0, 1.0):
        return reading
    from dashpot.data.conditioning.clock import cut
    from dashpot.data.conditioning.transients import continuous
    from dashpot.errors import DataError

    if reading.amplitudes is not None:
        raise DataError("a table of amplitudes has no samples to hold out", cure="give the records")
    records = tuple(cut(record, *part) for record in continuous(reading.records))
    return replace(reading, records=records)


def _was_given(option: str) -> bool:
    """Whether an option was written on the command line, which then counts more than a manifest."""
    context = click.get_current_context(silent=True)
    source = None if context is None else context.get_parameter_source(option)
    return source is not None and source is not click.core.ParameterSource.DEFAULT


def conditioning_from(options: Mapping[str, Any]) -> Conditioning:
    """The value of the options of `conditioning_options`, by their names."""
    from dashpot.data.conditioning.settings import Conditioning

    drift = options["drift"]
    treatments = {name: options[name] for name in CONDITIONING}
    treatments["transients"] = options.get("transients", "auto")
    treatments["band_hz"] = options.get("record_band") or "auto"
    return Conditioning(**{**treatments, "drift": int(drift) if drift.isdecimal() else drift})


def tell_notes(notes: Sequence[Notice], quiet: bool) -> None:
    """What was noticed, on stderr: the first of those that differ in numbers alone, and how many follow."""
    if quiet:
        return
    groups: dict[str, list[str]] = {}
    for note in dict.fromkeys(printable(str(notice)) for notice in notes):
        groups.setdefault(re.sub(r"\d[\d.]*(e[-+]?\d+)?", "#", note), []).append(note)
    for first, *others in groups.values():
        more = f" (and {len(others)} more like this)" if others else ""
        click.echo(f"note: {first}{more}", err=True)
