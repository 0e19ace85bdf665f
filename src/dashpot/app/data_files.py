"""Data files of a command: read, and turned into amplitudes as its options say; what was noticed on the way is told."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import click

from dashpot.app import options as opt
from dashpot.app.process import tell
from dashpot.app.workers import progress
from dashpot.errors import DataError, UsageError, printable
from dashpot.estimate.registry import method_class

if TYPE_CHECKING:
    from dashpot.data.conditioning.settings import Conditioning
    from dashpot.data.inspection import Inspection
    from dashpot.data.readers import Reading
    from dashpot.data.spectrum import Spectrum
    from dashpot.estimate.result import Estimate
    from dashpot.fleet.data_sets import Treatment
    from dashpot.model.rigfile import Rig
    from dashpot.notices import Notice


@dataclass(frozen=True)
class RecordOptions:
    """How time records become amplitudes, as the command line says, and the command's own `quiet`."""

    quiet: bool
    frequency: Annotated[
        float | None,
        opt.Option("--frequency HZ", opt.FREQUENCY, opt.RECORDS),
        "Drive frequency of records without a frequency_hz column.",
    ]
    orders: Annotated[
        Any,
        opt.Option("--orders auto|1,3,…", opt.ORDERS, opt.RECORDS, default="auto"),
        "Multiples of the drive frequency whose amplitudes are used as data; auto is 1 and, in long dwells, "
        "the harmonics that appear in every channel.",
    ]
    harmonics: Annotated[
        Any,
        opt.Option("--harmonics auto|none|2,3,…", opt.HARMONICS, opt.RECORDS, default="auto"),
        "Further multiples, fitted so that they do not count as noise.",
    ]
    drift: Annotated[
        Any,
        opt.Option(
            "--drift", click.Choice(["auto", "none", "0", "1", "2", "3"]), opt.RECORDS, default="auto"
        ),
        "Degree of the polynomial removed from each dwell: 0 removes the mean, 1 a linear trend; auto is 1, "
        "and 0 where short dwells show no slope.",
    ]
    noise: Annotated[
        Any,
        opt.Option("--noise", click.Choice(["auto", "own", "white", "blocks"]), opt.RECORDS, default="auto"),
        "How the noise of the amplitudes is estimated from the residuals: as white noise (white), from "
        "neighbouring frequencies (blocks), by a test of whiteness for each dwell (own), or likewise with "
        "short dwells pooled (auto).",
    ]
    refine: Annotated[
        Any,
        opt.Option(
            "--refine", click.Choice(["auto", "always", "none"]), opt.RECORDS, alone="always", default="auto"
        ),
        "Estimate the true drive frequency near the stated one: if all dwells together show that it is off "
        "(auto; a record that responds elsewhere is refused), always, or never; --refine alone is always.",
    ]
    settle: Annotated[
        Any,
        opt.Option("--settle auto|none|2s", opt.SETTLING, opt.RECORDS, alone="auto", default="none"),
        "Discard the start of each dwell: as long as the transient lasts (auto), or the time given; --settle "
        "alone is auto.",
    ]
    record_band: Annotated[
        tuple[float, float] | None,
        opt.Option("--band LOWER:UPPER", opt.BAND, opt.RECORDS),
        "Frequency band of continuous records, Hz.  [default: where the rig moves]",
    ]
    transients: Annotated[
        Any,
        opt.Option(
            "--transients", click.Choice(["auto", "estimate", "settle", "none"]), opt.RECORDS, default="auto"
        ),
        "Transients of dwells: estimate them if a test finds the dwells unsettled (auto), always (estimate) or "
        "never (none), or discard them where the test finds them (settle; auto does so for methods that cannot "
        "estimate them).  In continuous records they are always estimated.",
    ]
    noise_record: Annotated[
        tuple[str, ...],
        opt.Option("--noise-record FILE", opt.INPUT_FILE, opt.RECORDS, multiple=True),
        "An at-rest record, for the noise of every channel.  May be repeated.",
    ]

    @classmethod
    def usual(cls) -> RecordOptions:
        """Those of a command line that names none, quiet."""
        options = {
            name: next(each for each in hint.__metadata__ if isinstance(each, opt.Option)).attributes
            for name, hint in get_type_hints(cls, include_extras=True).items()
            if name != "quiet"
        }
        values: dict[str, Any] = {
            name: each.get("default", () if each.get("multiple") else None) for name, each in options.items()
        }
        return cls(True, **values)

    def reading(self, rig: Rig, paths: Sequence[str]) -> Reading:
        """What data files hold, with what was noticed told.

        Raises DataError, and UsageError for a file given twice and for --frequency unused.
        """
        from dashpot.api import read

        require_each_once(paths)
        with progress(reading_of(paths), self.quiet):
            reading = read(paths, rig, frequency_hz=self.frequency)
        if self.frequency is not None and all(one.frequency_hz != self.frequency for one in reading.records):
            cause = "--frequency is not needed: the data have a frequency_hz column"
            raise UsageError(cause, cure="leave it out")
        tell_notes(reading.notes, self.quiet)
        return reading

    def conditioning(self, rig: Rig, reading: Reading | None = None) -> Conditioning:
        """The treatments as a value; what a manifest among the data states counts where no option says otherwise.

        Raises DataError for a noise record that cannot be used.
        """
        from dashpot.data.conditioning.settings import Conditioning
        from dashpot.data.noise import noise_at_rest
        from dashpot.data.readers import read

        alike = ("orders", "harmonics", "noise", "refine", "settle", "transients")
        treatments: dict[str, Any] = {name: getattr(self, name) for name in alike}
        treatments["drift"] = int(self.drift) if self.drift.isdecimal() else self.drift
        treatments["band_hz"] = "auto" if self.record_band is None else self.record_band
        stated = {} if reading is None else reading.conditioning
        # What was written on the command line counts more than a manifest.
        context = click.get_current_context(silent=True)
        for name, value in stated.items():
            source = None if context is None else context.get_parameter_source(name)
            if source in (None, click.core.ParameterSource.DEFAULT):
                treatments[name] = value
        chosen = Conditioning(**treatments)
        if not self.noise_record:
            return chosen
        still = read(self.noise_record, rig.channels)
        tell_notes(still.notes, self.quiet)
        return chosen.changed(still=noise_at_rest(still.records, source=", ".join(self.noise_record)))

    def spectrum(
        self, rig: Rig, reading: Reading, conditioning: Conditioning, methods: Collection[str] = ()
    ) -> Spectrum:
        """The amplitudes of what was read, with what was noticed told.

        Second moments of the samples are kept where one of the methods needs them and the files hold samples;
        unsettled dwells are cut to what has settled where one of them knows no transients.  Raises DataError.
        """
        from dashpot.estimate.identify import amplitudes_for

        with progress("amplitudes", self.quiet):
            spectrum = amplitudes_for(rig.model, reading, conditioning, traits_of(methods))
        if self.record_band is not None and not spectrum.records:
            cause = "--band applies to continuous records; these are stepped-sine dwells"
            raise UsageError(cause, cure="leave it out")
        tell_notes(spectrum.notes, self.quiet)
        return spectrum

    def read(self, rig: Rig, paths: Sequence[str], methods: Collection[str] = ()) -> Spectrum:
        """The amplitudes of data files, as `reading`, `conditioning` and `spectrum` make them."""
        reading = self.reading(rig, paths)
        return self.spectrum(rig, reading, self.conditioning(rig, reading), methods)

    def require_in_time(self) -> None:
        """Raises UsageError for options that have no meaning where whole records are followed in time."""
        if self.record_band is not None:
            cause = (
                "--band applies to linear rigs; continuous records of nonlinear rigs are simulated in time"
            )
            raise UsageError(cause, cure="leave it out")

    def treatment(self, rig: Rig, chosen: str, positive: bool, seed: int) -> Treatment:
        """How every one of many data sets is treated.

        Raises UsageError if the method holds no bounds, DataError for a noise record that cannot be used.
        """
        from dashpot.fleet.data_sets import Treatment

        require_bounds_held(chosen, positive)
        method = None if chosen == "auto" else chosen
        return Treatment(method, self.conditioning(rig), self.frequency, positive, seed)


def traits_of(methods: Collection[str]) -> list[Any]:
    """What methods of these names need and are; auto decides later."""
    return [method_class(name).traits for name in methods if name != "auto"]


def require_bounds_held(method: str, positive: bool) -> None:
    """Refuse --positive, before the work, with a method that cannot hold bounds.  Raises UsageError."""
    if positive and not all(traits.bounds for traits in traits_of([method])):
        raise UsageError(
            f"the method {method} cannot enforce bounds", cure="leave out --positive, or use --method ml"
        )


def require_each_once(paths: Sequence[str]) -> None:
    """Raises UsageError if a file is named twice: its noise would count as that of two tests."""
    files = [os.path.realpath(path) for path in paths]
    for path, file in zip(paths, files, strict=True):
        if files.count(file) > 1:
            raise UsageError(
                f"{printable(path)} is given {files.count(file)} times, but is one test",
                cure="name each file once",
            )


def reading_of(paths: Sequence[str]) -> str:
    """What is being read, in a few words."""
    name = printable(os.path.basename(paths[0]))
    return f"reading {name[:40]}" + (f" and {len(paths) - 1} more" if len(paths) > 1 else "")


def inspected(files: Sequence[str]) -> list[Inspection]:
    """What files hold, or those of manifests, each said as soon as it is read."""
    from dashpot.data.inspection import inspect_named
    from dashpot.present.data import inspection_document
    from dashpot.present.document import say

    every: list[Inspection] = []
    for name in files:
        with progress(reading_of([name])):
            found = inspect_named(name)
        for inspection in found:
            say(inspection_document(inspection))
        every += found
    return every


def part_of(reading: Reading, part: tuple[float, float]) -> Reading:
    """The same with the share `part` of every record's samples.  Raises DataError if there are none."""
    if part == (0.0, 1.0):  # a share of every record's samples, from where to where: all of them
        return reading
    from dashpot.data.conditioning.clock import cut
    from dashpot.data.conditioning.whole_record import continuous

    if reading.amplitudes is not None:
        raise DataError("a table of amplitudes has no samples to hold out", cure="give the records")
    records = tuple(cut(record, *part) for record in continuous(reading.records))
    return replace(reading, records=records)


def estimate_and_rig(path: str, rig: str | None) -> tuple[Estimate, Rig]:
    """An estimate with the rig it was made of: the one given, else that which it carries or names.

    Raises DataError or UsageError.
    """
    from dashpot.estimate.result import Estimate
    from dashpot.model.rigfile import read_rig

    estimate = Estimate.load(path)
    if rig is not None:
        return estimate, read_rig(rig)
    carried = estimate.carried_rig()
    if carried is not None:
        return estimate, carried
    if estimate.rig is None:
        raise UsageError(f"{path} does not name its rig file", cure="give it with --rig")
    for candidate in (Path(estimate.rig), Path(path).parent / estimate.rig):
        if os.path.isfile(candidate):  # False, too, of a name too long for a file
            return estimate, read_rig(str(candidate))
    raise UsageError(
        f"the rig file {estimate.rig} that {path} names does not exist", cure="give it with --rig"
    )


def tell_notes(notes: Sequence[Notice], quiet: bool) -> None:
    """What was noticed, on stderr: the first of those that differ in numbers alone, and how many follow."""
    if quiet:
        return
    groups: dict[tuple[str, str], list[str]] = {}
    for note, code in dict.fromkeys((printable(str(notice)), notice.code) for notice in notes):
        groups.setdefault((code, re.sub(r"\d[\d.]*(e[-+]?\d+)?", "#", note)), []).append(note)
    for (code, _), (first, *others) in groups.items():
        more = f" (and {len(others)} more like this)" if others else ""
        tell(f"note: {first}{more} [{code}]")
