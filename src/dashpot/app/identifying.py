"""How the command identify comes to its estimate: from data together, from histories, or part by part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from dashpot.errors import UsageError

if TYPE_CHECKING:
    from dashpot.data.conditioning.used_dwells import UsedDwell
    from dashpot.data.record import Record
    from dashpot.data.spectrum import Spectrum
    from dashpot.errors import ConvergenceError, DashpotError, IdentifiabilityError
    from dashpot.estimate.result import Estimate
    from dashpot.fleet.data_sets import Treatment
    from dashpot.model.network import Model
    from dashpot.model.rigfile import Rig


# identify from a file of measured modes, which takes the place of test data.


def modal_estimate(
    rig_path: str,
    data: tuple[str, ...],
    relative_sd: tuple[float, float, float],
    seed: int,
    quiet: bool,
    unsuited: Mapping[str, bool],
) -> tuple[Rig, Estimate] | None:
    """The rig and the estimate from a file of modes; None where the data are another thing.

    `unsuited` are options that need amplitudes, and whether they are given.  Raises UsageError for these, DataError.
    """
    from dataclasses import replace

    from dashpot.app.data_files import tell_notes
    from dashpot.data.readers.modes import holds_modes, modes_and_notes
    from dashpot.errors import UsageError

    if len(data) != 1 or not holds_modes(data[0]):
        return None
    from dashpot.app.progress import progress
    from dashpot.check.modal_verdict import examined_modes
    from dashpot.estimate.modal.identify_modal import identify_modal  # loads scipy.optimize
    from dashpot.model.rigfile import read_rig

    given = [name for name, is_given in unsuited.items() if is_given]
    if given:
        raise UsageError(
            f"{data[0]} holds modes, to which {given[0]} does not apply", cure=f"leave {given[0]} out"
        )
    rig = read_rig(rig_path)
    modes, notes = modes_and_notes(data[0], rig.model.coordinates, rig.channels, relative_sd)
    tell_notes(notes, quiet)
    estimate = identify_modal(rig.model, modes, seed=seed)
    with progress("examine", quiet):
        return rig, replace(examined_modes(rig.model, modes, estimate, seed=seed), rig=rig_path)


# Data sets that workers read and identify: how they are treated, and one rig's merged into one estimate.


def treatment_from(
    rig: Rig, chosen: str, positive: bool, seed: int, options: Mapping[str, Any], quiet: bool
) -> Treatment:
    """How every data set is treated, from the options of `conditioning_options` and of the estimator.

    Raises UsageError where the method holds no bounds, DataError for a noise record that cannot be used.
    """
    from dashpot.app.data_files import conditioning_from, with_noise_record
    from dashpot.app.parameters import require_bounds_held
    from dashpot.fleet.data_sets import Treatment

    if positive:
        require_bounds_held(chosen)
    settings = with_noise_record(conditioning_from(options), rig, options, quiet)
    method = None if chosen == "auto" else chosen
    return Treatment(method, settings, options["frequency"], positive, seed)


def estimate_in_parts(
    path: str,
    rig: Rig,
    data: Sequence[str],
    treatment: Treatment,
    workers: int | None,
    dask: str | None,
    quiet: bool,
) -> Estimate:
    """The merged estimate of all files, shared out to worker processes or a cluster.

    Raises UsageError for nonlinear rigs and files given twice, and what `identify_in_parts` raises.
    """
    from dataclasses import replace

    from dashpot.app.data_files import require_each_once, tell_notes
    from dashpot.app.progress import progress
    from dashpot.app.workers import shared_out
    from dashpot.fleet.record_parts import identify_in_parts
    from dashpot.io.ledger import noted

    if len(rig.model.nonlinear):
        raise UsageError(
            "parts can be merged for linear rigs only",
            "--in-parts",
            "identify some of the files together, without it",
        )
    require_each_once(data)
    files = [noted(name) for name in data]
    with shared_out(dask, workers, len(files) == 1) as mapper, progress("identify", quiet) as moved:
        estimate = identify_in_parts(rig, files, treatment, mapper=mapper, progress=moved)
    tell_notes(estimate.notes, quiet)
    return replace(estimate, rig=path)


def require_in_parts(in_parts: bool, sharing: Mapping[str, bool], whole: Mapping[str, bool]) -> None:
    """Raises UsageError for options given that need --in-parts (`sharing`), or that it cannot serve (`whole`)."""
    wrong = next((name for name, given in (whole if in_parts else sharing).items() if given), None)
    if wrong is None:
        return
    if in_parts:
        raise UsageError(
            f"{wrong} needs all data at once, and --in-parts never has them",
            cure="identify one file, without it",
        )
    raise UsageError(f"{wrong} shares out the parts of --in-parts", cure="give that too, or leave it out")


@dataclass(frozen=True)
class Search:
    """How an estimate is looked for: rig file, method and its options."""

    path: str
    chosen: str
    positive: bool
    seed: int
    quiet: bool


@dataclass(frozen=True)
class Identified:
    """An estimate and what it was made from, as far as that can be shown; `in_time`: from histories, not a spectrum."""

    rig: Rig
    estimate: Estimate
    spectrum: Spectrum | None = None
    untried: tuple[str, ...] = ()
    dwells: tuple[UsedDwell, ...] = ()
    in_time: bool = False


def identified_in_parts(
    search: Search, rig: Rig, data: tuple[str, ...], conditioning: dict[str, Any], workers: int | None,
    dask: str | None,
) -> Identified:  # fmt: skip
    """From every file by itself, merged."""

    treatment = treatment_from(rig, search.chosen, search.positive, search.seed, conditioning, search.quiet)
    return Identified(rig, estimate_in_parts(search.path, rig, data, treatment, workers, dask, search.quiet))


def identified_together(
    search: Search, rig: Rig, data: tuple[str, ...], conditioning: dict[str, Any], used: tuple[float, float],
    with_dwells: bool,
) -> Identified:  # fmt: skip
    """From all files together, of whose records the share `used` counts."""
    from dashpot.app.data_files import measured_data, part_of, read_files

    reading = read_files(rig, data, conditioning, search.quiet)
    if len(rig.model.nonlinear) and reading.continuous:
        records = part_of(reading, used).records
        estimate = _of_whole_records(search.path, rig, records, conditioning, search.chosen, search.quiet)
        return Identified(rig, estimate, in_time=True)
    measured = measured_data(
        rig,
        reading,
        conditioning,
        search.quiet,
        moments_for=[search.chosen],
        part=used,
        with_dwells=with_dwells,
    )
    estimate, spectrum = _estimated(search, rig, measured.spectrum)
    return Identified(rig, estimate, spectrum, measured.untried, measured.dwells)


def _of_whole_records(
    path: str, rig: Rig, records: Sequence[Record], options: dict[str, Any], chosen: str, quiet: bool
) -> Estimate:
    """The estimate from continuous records of a nonlinear rig, examined."""
    from dataclasses import replace

    from dashpot.app.data_files import conditioning_from, with_noise_record
    from dashpot.app.progress import progress
    from dashpot.check.diagnosis.record_channels import require_sound_channels
    from dashpot.check.verdict import examined_records, with_causes
    from dashpot.errors import IdentifiabilityError, UsageError
    from dashpot.estimate.nonlinear.whole_record import fit_records

    if options.get("record_band") is not None:
        cause = "--band chooses frequencies, and whole records of nonlinear rigs are followed in time"
        raise UsageError(cause, cure="leave it out")
    wanted = None if chosen == "auto" else chosen
    still = with_noise_record(conditioning_from(options), rig, options, quiet).still
    require_sound_channels(rig.model, records)
    with progress("identify", quiet) as moved:
        fitted = fit_records(rig.model, records, wanted, still=still, progress=moved)
        try:
            estimate = fitted.estimate()
        except IdentifiabilityError as error:
            raise with_causes(error, rig.model, records) from error
    with progress("examine", quiet):
        return replace(examined_records(rig.model, records, estimate, fitted, rig.within), rig=path)


def _estimated(search: Search, rig: Rig, spectrum: Spectrum) -> tuple[Estimate, Spectrum]:
    """The estimate, examined, and the amplitudes with the noise that it rests on.

    Where the method was not `chosen` by name, another takes its place if it finds no answer.
    """
    from dataclasses import replace

    from dashpot.app.progress import progress
    from dashpot.check.deficiencies import require_identifiable
    from dashpot.check.diagnosis.diagnose import examined
    from dashpot.errors import ConvergenceError, IdentifiabilityError
    from dashpot.estimate.automatic import identify_with_noise

    seed, wanted = search.seed, None if search.chosen == "auto" else search.chosen
    require_identifiable(rig.model, spectrum.channels, search.path, spectrum)
    with progress("identify", search.quiet) as moved:
        try:
            estimate, spectrum = identify_with_noise(
                rig.model, spectrum, wanted, seed=seed, positive=search.positive, progress=moved
            )
        except (IdentifiabilityError, ConvergenceError) as error:
            raise _explained(error, rig.model, spectrum, seed) from error
    with progress("examine", search.quiet):
        return replace(
            examined(rig.model, spectrum, estimate, seed=seed, within=rig.within), rig=search.path
        ), spectrum


def _explained(
    error: IdentifiabilityError | ConvergenceError, model: Model, spectrum: Spectrum, seed: int
) -> DashpotError:
    """The error, with what would make the rig fit where something does."""
    from dashpot.check.diagnosis.diagnose import diagnose
    from dashpot.check.diagnosis.wording import with_likely_causes

    return with_likely_causes(error, diagnose(model, spectrum, seed=seed)[:1])
