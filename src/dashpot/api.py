"""The public verbs as people type them: a rig where a model is expected, a path where a spectrum is.

    rig = read_rig("rig.toml")
    estimate = identify(rig, "data.csv")        # or rig.identify("data.csv")

The order of arguments is the same in all: the rig, what is known of it, the data, how; what reads begins with what it
reads and the channels that say what that is.  Methods of Rig, Spectrum and Estimate with these names are short for
them (`dashpot.shorthand`).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np

from dashpot.arrays import Complex, Real, random_generator
from dashpot.channel import RUNS, Channel, Quantity, kind_of
from dashpot.check.deficiencies import require_identifiable
from dashpot.check.explain.effect import with_likely_causes
from dashpot.check.explain.examine import diagnose as diagnosis
from dashpot.check.explain.examine import examined
from dashpot.check.explain.in_time import examined_records
from dashpot.check.explain.laws import in_place_of_laws
from dashpot.check.explain.record_channels import require_sound_channels
from dashpot.check.identifiability import Structure, nonlinear_structure, structure
from dashpot.data import readers
from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.conditioning.unmeasured import marked_whole
from dashpot.data.inspection import channels_in, inspect_columns, inspect_named
from dashpot.data.modal_data import ModalData, at_coordinates
from dashpot.data.noise import Still
from dashpot.data.readers import Reading
from dashpot.data.readers.in_memory import columns_in_memory, records_of
from dashpot.data.readers.interpretation import Experiments
from dashpot.data.readers.modes import holds_modes, read_modes
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import ConvergenceError, DashpotError, DataError, IdentifiabilityError, UsageError
from dashpot.estimate import comparison as comparisons
from dashpot.estimate.assessment import Finding
from dashpot.estimate.automatic import identify_with_noise
from dashpot.estimate.comparison import Comparison
from dashpot.estimate.identify import amplitudes_for
from dashpot.estimate.inference.uncertainty import linear_modes
from dashpot.estimate.method import Method
from dashpot.estimate.modal import identify_modal
from dashpot.estimate.nonlinear.search import linear_rig
from dashpot.estimate.nonlinear.whole_record import fit_records
from dashpot.estimate.registry import method as named_method
from dashpot.estimate.registry import method_class, methods_for
from dashpot.estimate.result import Cycle, Estimate, Origin, Value
from dashpot.free import MOST_MODES
from dashpot.io.atomic import write_text
from dashpot.io.ledger import opened
from dashpot.io.toml_document import PLACEHOLDER, inline_texts
from dashpot.io.words import choose_from, listed, names_in
from dashpot.model.modes import Modes, eigenmodes
from dashpot.model.network import Model
from dashpot.model.observation import measures_input
from dashpot.model.rigfile import Rig, default_channels, parse_rig, read_rig
from dashpot.numerics.blas_threads import one_blas_thread
from dashpot.quantities import frequencies as frequencies_of
from dashpot.quantities import quantity, quantity_of_unit

if TYPE_CHECKING:
    from dashpot.export.identified_rig import IdentifiedRig
    from dashpot.export.state_space import StateSpace
    from dashpot.export.transfer_functions import TransferFunctions
    from dashpot.fleet.tracking import Track
    from dashpot.free.modes import MeasuredModes
    from dashpot.free.response import MeasuredResponse
    from dashpot.present.schematic.drawing import Drawing

AnyPath = str | os.PathLike[str]
Columns = Any  # a mapping of names to arrays, a data frame, an xarray Dataset, a structured array: as for `records_of`
Data = (
    Spectrum | Reading | Record | AnyPath | Columns | Sequence[Record] | Sequence[AnyPath] | Sequence[Columns]
)
Progress = Callable[[int, int], None]


def read(
    paths: AnyPath | Sequence[AnyPath],
    channels: Sequence[Channel] | Rig,
    *,
    frequency_hz: float | None = None,
) -> Reading:
    """Read data files; `channels` describes their columns: a rig, its channels, or a list of channels.

    `frequency_hz` is the drive frequency of time records that have no such column.  Raises DataError with one problem
    per cause, each with file, row and column.
    """
    if isinstance(channels, Rig):
        by = channels.experiments
        return readers.read(paths, channels.channels, frequency_hz=frequency_hz, experiments=by)
    return readers.read(paths, channels, frequency_hz=frequency_hz)


@one_blas_thread()
def identify(
    rig: Rig | Model,
    data: Data | ModalData,
    method: Method | str | None = None,
    *,
    frequency_hz: float | None = None,
    conditioning: Conditioning | None = None,
    judge: bool | None = None,
    within: float | None = None,
    positive: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
    diagnose: bool | None = None,
) -> Estimate:
    """Estimate the unknowns of a rig from data, as the command does.

    rig     a Rig, or a Model, whose channels are then its coordinates and inputs in SI units
    data    a Spectrum (with batch axes: repeats of one test), files by name, Records, what `read` returned, columns
            by name with `time_s`: a data frame, a mapping of names to arrays, an xarray Dataset; or measured modes, as
            ModalData or in a file
    method  a method or its name, such as "ml"; by default the most precise one that suits the data
    frequency_hz, conditioning  for time records: their drive frequency, and how they are turned into amplitudes
    judge   judge the fit and look for causes of a misfit; `print(estimate)` shows both.  Default: True for a Rig, False
            for a Model and for batches.  (Formerly `diagnose`.)
    within  share of each channel's motion that the rig may miss, such as 0.02; by default that of the rig file, or
            what suits the noise
    positive, seed  keep every unknown at or above 0; seed of the random starts.  For a method given by name

    `progress(done, all)` is called between chunks of repeats.  Raises DataError or UsageError if the data lack what
    the method needs, IdentifiabilityError if they do not determine the unknowns, ConvergenceError if no search
    converges, and ModelError if the rig has no steady response.
    """
    judge = diagnose if judge is None else judge
    judged = isinstance(rig, Rig) if judge is None else judge
    model, within = _model(rig), rig.within if within is None and isinstance(rig, Rig) else within
    if isinstance(data, str | os.PathLike) and holds_modes(data):
        data = read_modes(data, model.coordinates, _channels(rig))
    if isinstance(data, ModalData):
        from dashpot.check.explain.modal import examined_modes

        if isinstance(rig, Rig):
            rig.require_alike("identification from measured modes")
        data = at_coordinates(data, model.coordinates, _channels(rig))
        estimate = identify_modal(model, data, seed=seed)
        return _of_rig(rig, examined_modes(model, data, estimate, seed=seed) if judged else estimate)
    files: tuple[str, ...] = ()
    if not isinstance(data, Spectrum):
        with opened() as ledger:
            data = _reading(rig, data, frequency_hz)
            files = tuple(ledger.inputs)
        if data.continuous and len(model.nonlinear):
            still = None if conditioning is None else conditioning.still
            name = method if method is None or isinstance(method, str) else method.name
            estimate = _in_time(model, data.records, name, still, judged, within, progress)
            return _of_rig(rig, estimate, None, files, data.records)
    spectrum = _spectrum(rig, data, frequency_hz, conditioning, [] if method is None else [method])
    _require_measured(rig, spectrum)
    require_identifiable(
        model, spectrum.channels, rig.path or None if isinstance(rig, Rig) else None, spectrum
    )
    judged = bool(judge) or (judged and not spectrum.batch)
    try:
        estimate, spectrum = identify_with_noise(
            model, spectrum, method, seed=seed, positive=positive, progress=progress
        )
    except (IdentifiabilityError, ConvergenceError) as error:
        if not judged or spectrum.batch:
            raise
        explained = with_likely_causes(error, diagnosis(model, spectrum, seed=seed)[:1])
        if explained is error and isinstance(error, IdentifiabilityError):
            how = {"frequency_hz": frequency_hz, "conditioning": conditioning, "seed": seed}
            explained = _without_laws(error, model, data, **how)
        if explained is error:  # which must not be its own cause
            raise
        raise explained from error
    if judged:
        estimate = examined(model, spectrum, estimate, seed=seed, within=within)
    return _of_rig(rig, estimate, spectrum, files)


def _in_time(
    model: Model,
    records: Sequence[Record],
    method: str | None,
    still: Still | None,
    judged: bool,
    within: float | None,
    progress: Progress | None,
) -> Estimate:
    """The estimate from continuous records of a nonlinear rig, whose motion is followed in time."""
    marked = [marked_whole(record) for record in records]
    records, notes = [each for parts, _ in marked for each in parts], [n for _, told in marked for n in told]
    require_sound_channels(model, records)
    try:
        fitted = fit_records(model, records, method, still=still, progress=progress)
        estimate = fitted.estimate()
        estimate = replace(estimate, notes=(*estimate.notes, *notes))
    except IdentifiabilityError as error:
        explained = _without_laws(error, model, records) if judged else error
        if explained is error:
            raise
        raise explained from error
    return examined_records(model, records, estimate, fitted, within) if judged else estimate


def _without_laws(error: IdentifiabilityError, model: Model, data: Data, **how: Any) -> IdentifiabilityError:
    """The error, with what is the matter with the rig without its nonlinear elements, as they leave no trace."""
    if not len(model.nonlinear):
        return error
    try:
        assessment = identify(linear_rig(model), data, judge=True, **how).assessment
        causes = () if assessment is None else assessment.findings
    except DashpotError as other:
        causes = tuple(each for each in other.causes if isinstance(each, Finding))
    if causes[:1] and causes[0].kind == "unexplained":
        return error
    # Laws among them were found with the rig's own left out; all else is wrong in addition to these as well.
    told = (in_place_of_laws(model, each) if each.kind == "nonlinear" else each for each in causes)
    return with_likely_causes(error, tuple(told))


@one_blas_thread()
def compare(
    rig: Rig | Model,
    data: Data | None,
    methods: Mapping[str, Method] | Iterable[str] | None = None,
    *,
    modal: ModalData | None = None,
    refused: Mapping[str, DashpotError] | None = None,
    truth: Mapping[str, float] | None = None,
    seed: int = 0,
    frequency_hz: float | None = None,
    conditioning: Conditioning | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Estimate the unknowns with several methods: all that suit, those named, or those given by name.

    `data` is as for `identify`, or None if there are only measured modes (`modal`).  `truth` holds true values by
    name in SI units.  `refused` holds methods already ruled out, with the reason.  Raises the errors of `identify`
    if every method fails, and UsageError if `truth` names something that is not an unknown.
    """
    model = _model(rig)
    if methods is None:
        methods = methods_for(model)
    if not isinstance(methods, Mapping):
        methods = {name: named_method(name, seed=seed) for name in methods}
    spectrum = None if data is None else _spectrum(rig, data, frequency_hz, conditioning, methods.values())
    if spectrum is not None:
        _require_measured(rig, spectrum)
    return comparisons.compare(
        model,
        spectrum,
        {} if spectrum is None else methods,
        modal=None if modal is None else at_coordinates(modal, model.coordinates, _channels(rig)),
        refused=refused,
        truth=truth,
        seed=seed,
        progress=progress,
    )


@one_blas_thread()
def check(
    rig: Rig, data: Data | None = None, *, frequency_hz: float | None = None, seed: int = 0
) -> Structure:
    """Whether the unknowns of a rig can be found from its channels and, with data, from their frequencies.

    Raises IdentifiabilityError if the rig has no steady response, DataError if the data do not suit the rig.
    """
    spectrum = None if data is None else _spectrum(rig, data, frequency_hz, None, [])
    channels = rig.all_channels if spectrum is None else spectrum.channels
    if spectrum is not None:
        _require_measured(rig, spectrum)
    if len(rig.model.nonlinear):
        return nonlinear_structure(rig.model, channels, spectrum)
    return structure(rig.model, channels, spectrum, seed)


@one_blas_thread()
def simulate(
    rig: Rig,
    values: Mapping[str, float | str | Value],
    frequencies: Any = None,
    *,
    release: Mapping[str, float] | None = None,
    samples: int = 200,
    amplitudes: Mapping[str, complex | Complex] | None = None,
    periods: float = 10.0,
    rate: float | None = None,
    seed: int = 0,
    experiment: str | None = None,
) -> tuple[Record, ...]:
    """Simulate the records of a rig, with the noise stated for its channels.

    values       by name, SI units or text such as "9 kN/m", or `estimate.parameters()`: the unknowns, and known
                 values to be replaced; anything missing is taken from the values and guesses of the rig file
    frequencies  Hz, one per dwell: a sequence, or text as on the command line ("1:10:0.5", "1:10/25"); or the motion of
                 the inputs, starting from rest: a Record, or columns by name with `time_s`, in one or more stretches
    release      instead of frequencies: the displacement at which each coordinate is held, m or rad, before it is let
                 go; `samples` are taken at `rate`
    samples      per dwell, spread over `periods` or taken at `rate` (Hz)
    amplitudes   of the inputs by name, SI units, one value or one per frequency; by default the most that the shaker
                 in the rig file can do, or 1 if none is stated
    experiment   name of an experiment in the rig file; by default none

    Raises UsageError if an unknown has no value or an input does not exist, ModelError if the rig has no steady
    response, and DataError if a channel measures something that the rig does not have.
    """
    from dashpot.study import simulate as simulation

    # The rig with known values as stated, and its unknowns, (unknowns,); what is tied follows them
    rig = rig.in_experiment(experiment)
    units = {each.name: rig.model.unit(each) for each in rig.model.elements}
    units |= {unknown.name: unknown.unit for unknown in rig.model.unknowns}
    numbers = {
        name: _in_si(value.value if isinstance(value, Value) else value, name, units.get(name, ""))
        for name, value in values.items()
    }
    rig = _with_known(rig, numbers)
    elsewhere = {name for name, value in values.items() if isinstance(value, Value)}
    elsewhere |= {element.name for element in rig.model.elements if element.value is not None}
    unknown = set(rig.model.unknown_names)
    theta = rig.model.theta(
        {name: value for name, value in numbers.items() if name in unknown or name not in elsewhere}
    )
    model = rig.model
    if (frequencies is None) == (release is None):
        raise UsageError("the rig needs exactly one drive", cure="give frequencies, or a release")
    if release is not None:
        if rate is None:
            raise UsageError("a release has no sampling rate", cure="give rate, in Hz")
        time, held = (
            np.arange(samples) / rate,
            {name: float(_numbers(x, name)) for name, x in release.items()},
        )
        return (simulation.released_record(model, theta, rig.channels, held, time, random_generator(seed)),)
    if isinstance(frequencies, Record | Reading) or _has_columns(frequencies):  # what inputs do
        rng = random_generator(seed)
        drives = _inputs(rig, frequencies)
        return tuple(simulation.driven_record(model, theta, rig.channels, drive, rng) for drive in drives)
    if isinstance(frequencies, str):
        frequencies = frequencies_of(frequencies)
    chosen = np.atleast_1d(_numbers(frequencies, "frequencies"))
    if rig.shaker is not None:
        amplitudes = simulation.amplitudes_within(model, theta, rig.shaker, chosen, amplitudes or {})
    test = simulation.dwells(model, chosen, samples, amplitudes=amplitudes, periods=periods, rate=rate)
    if len(model.nonlinear):
        motion = simulation.settled_motion(model, theta, rig.channels, test)
        return tuple(simulation.steady_records(rig.channels, motion, test, random_generator(seed)))
    return tuple(
        simulation.simulate_records(
            model, model.parameters(theta), rig.channels, test, random_generator(seed)
        )
    )


def start(
    data: AnyPath | Columns | Sequence[AnyPath],
    *,
    driven_by: Literal["base", "force", "release", "stand"] | None = None,
    units: Mapping[str, str] | None = None,
    name: str = "My rig",
    first_mass: float | None = None,
    force_at: str | None = None,
    base: str | None = None,
) -> Rig:
    """Suggest a first rig from data: one channel per column, every parameter unknown.

    data        files by name, a manifest of them, a data frame or a mapping of columns
    driven_by   what drives the rig; by default, what the columns suggest
    units       of columns without a unit, by name; otherwise SI units are assumed
    first_mass  kg, if it was weighed; 1 if nothing else sets the scale
    force_at    coordinate on which the force acts, such as "x1"; required if there are several masses
    base        column of the base motion; required if no column is named like one

    `dashpot.write_rig(rig)` returns its rig file.  Raises UsageError if the columns cannot belong to a rig, or if it is
    unclear what a column measures or where a force acts.
    """
    from dashpot.check.first_rig import first_rig, seen_data
    from dashpot.model.rigfile.writer import starter_text

    several = _several(data)
    seen = seen_data(
        [
            inspection
            for each in several
            for inspection in (
                inspect_named(each)
                if isinstance(each, str | os.PathLike)
                else [inspect_columns(columns_in_memory(each, type(each).__name__))]
            )
        ]
    )
    for source, names in seen.renamed.items():
        what = f"{source}: its columns have other names than those of the first file"
        raise UsageError(
            what, cure=f"write a manifest with columns = {inline_texts(names)}, or read one file"
        )
    stated = units or {}
    si = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s²", "force": "N"}
    columns = []
    for column in seen.columns:
        unit = stated.get(column.name, column.unit or si.get(column.quantity or ""))
        if unit is None:
            cure = f'give its unit, units={{"{column.name}": "m/s²"}}'
            raise UsageError(f"cannot tell what the column {column.name} measures", cure=cure)
        columns.append(column.in_unit(unit))
    seen = replace(seen, columns=tuple(columns))
    drive = driven_by or ("base" if base else "force" if force_at else seen.drive)
    chain = first_rig(seen, name, drive, first_mass, force_at, base)
    if chain.drive == "force" and chain.forces > 1:
        cure = "leave out the columns of the others, or complete the file that `dashpot start` writes"
        raise UsageError(f"{chain.forces} columns are forces; where each acts is not known", cure=cure)
    if chain.at == PLACEHOLDER:
        cure = f"give force_at=, one of x1 to x{chain.masses}"
        raise UsageError("which mass the force acts on is not known", cure=cure)
    for sensor in chain.sensors:
        if sensor.of == PLACEHOLDER:
            cure = "give base=, the column of the base, or another driven_by="
            raise UsageError(f"cannot tell what the column {sensor.column} measures", cure=cure)
        if sensor.gain == PLACEHOLDER:
            what = f"the column {sensor.column} is in {sensor.unit}, without a sensitivity"
            raise UsageError(what, cure="give it in a unit of what it measures")
    return parse_rig(starter_text(chain))


def draw(
    rig: Rig | Model,
    estimate: Estimate | MeasuredModes | None = None,
    *,
    mode: int | None = None,
    level: float = 0.95,
) -> Drawing:
    """The rig as a schematic: a value that notebooks show and `save("rig.svg")` writes (.svg, .png or .pdf).

    estimate  its values and intervals at `level` are written at the elements; or the modes of a test, to draw those
    mode      draws this mode instead, 1 being the lowest: of the estimate, the test, or the values in the rig

    Raises UsageError if the rig has too many bodies to draw or no such mode, and ModelError or DataError if the rig or
    its channels are invalid.
    """
    from dashpot.check.evidence import doubtful, undetermined
    from dashpot.free.modes import MeasuredModes
    from dashpot.present.schematic.drawing import (
        measured_modes_drawing,
        mode_drawing,
        numbered_mode,
        schematic,
    )

    rig = rig.in_experiment() if isinstance(rig, Rig) else rig
    model, channels = _model(rig), _channels(rig)
    if isinstance(estimate, MeasuredModes):
        return measured_modes_drawing(model, channels, estimate, mode)
    if mode is not None:
        title, shape = numbered_mode(model, estimate, mode)
        return mode_drawing(model, shape, title)
    marks = undetermined(model, channels) if estimate is None else doubtful(estimate, level)
    return schematic(model, channels, estimate, marks, level)


def state_space(
    rig: Rig | Estimate,
    source: Estimate | Rig | Mapping[str, float] | None = None,
    *,
    given: str | Mapping[str, str] | None = None,
) -> StateSpace:
    """State space of a rig from its inputs to its channels, in SI units and without calibrations.

    rig, source  a rig with its estimate or with values of the unknowns by name; or an estimate alone, whose rig file
                 is then read
    given        quantity in which displacement inputs are supplied: "displacement", "velocity" or "acceleration", for
                 all inputs or by name; by default as measured, differentiated until every channel is proper

    Raises ModelError for nonlinear and hysteretic elements and for coordinates without mass, UsageError if values are
    missing or `given` is impossible, and DataError if the estimate belongs to another rig.
    """
    from dashpot.export.state_space import state_space_of

    return state_space_of(_identified(rig, source), given)


def transfer_functions(
    rig: Rig | Estimate,
    source: Estimate | Rig | Mapping[str, float] | None = None,
    *,
    given: str | Mapping[str, str] | None = None,
) -> TransferFunctions:
    """Poles, zeros, gains and polynomials from each input to each channel.

    SI units; arguments and errors as for `state_space`.
    """
    from dashpot.export.transfer_functions import transfer_functions_of

    return transfer_functions_of(state_space(rig, source, given=given))


def export(
    rig: Rig | Estimate,
    path: AnyPath,
    source: Estimate | Rig | Mapping[str, float] | None = None,
    *,
    content: str | None = None,
    frequencies: str | Sequence[float] | None = None,
    data: Data | None = None,
    given: str | Mapping[str, str] | None = None,
) -> tuple[str, ...]:
    """Write a rig for another program, by the end of the file's name; the names of the files.

    content      such as "transfer-functions", where an ending may mean several
    frequencies  Hz, of frequency responses; those of `data` without it
    data         measured data as for `identify`, whose frequency responses are written (.uff)

    Other arguments as for `state_space`.  Raises UsageError for an unknown ending, ModelError if the format cannot
    hold the rig.
    """
    from dashpot.export.formats import ExportOptions, export_rig

    of_rig = _identified(rig, source)
    chosen = frequencies_of(frequencies) if isinstance(frequencies, str) else frequencies
    whole = Rig(of_rig.model, of_rig.channels)
    options = ExportOptions(
        given=given,
        frequency_hz=None if chosen is None else np.asarray(chosen, dtype=float),
        data=None if data is None else _spectrum(whole, data, None, None, []),
    )
    return export_rig(of_rig, path, content, options).paths


def _identified(rig: Rig | Estimate, source: Estimate | Rig | Mapping[str, float] | None) -> IdentifiedRig:
    """A rig with values, whichever way round they are given; known values are those of the estimate."""
    from dashpot.export.identified_rig import identified_rig

    estimate = rig if isinstance(rig, Estimate) else source if isinstance(source, Estimate) else None
    whole = rig if isinstance(rig, Rig) else source if isinstance(source, Rig) else None
    if whole is None or estimate is not None:
        whole = _rig_of(estimate, whole)
    values = source if isinstance(source, Mapping) else None
    return identified_rig(whole, estimate, values)


def estimated_frf(
    estimate: Estimate, output: str, input: str, frequencies_hz: Any, rig: Rig | None = None
) -> tuple[Any, Any]:
    """The frequency response that an estimate predicts, and the standard deviation of its real (imaginary) part alike.

    output, input   channels of the rig by name, or a coordinate and an input of it: their amplitudes in SI units
    frequencies_hz  a number, or an array, whose shape both have
    rig             of an estimate that does not name its rig file

    Raises UsageError if the rig has no such channel or input, ModelError as `transfer_functions`.
    """
    from dashpot.export.transfer_functions import frequency_responses

    of_rig = _identified(estimate, rig)
    model, default = of_rig.model, default_channels(of_rig.model)
    named = {channel.name: channel for channel in (*default, *of_rig.channels)}
    for name in (output, input):
        if name not in named:
            raise UsageError(f"there is no channel {name}", cure=choose_from(named))
    shown, drive = named[output], named[input]
    if not measures_input(model, drive) or len(drive.of) != 1:
        inputs = [channel.name for channel in named.values() if measures_input(model, channel)]
        raise UsageError(f"{input} is not an input of the rig", cure=f"use {' or '.join(inputs)}")
    if measures_input(model, shown):
        raise UsageError(f"{output} is an input of the rig", cure="name a channel of its coordinates")
    frequency_hz = _numbers(frequencies_hz, "frequencies_hz")
    H, sd = frequency_responses(replace(of_rig, channels=(shown,)), frequency_hz.ravel())
    ((point, factor),) = drive.of.items()
    moved = drive.quantity is not Quantity.FORCE
    points = model.displacement_inputs if moved else model.force_inputs
    j = points.index(point) + (0 if moved else len(model.displacement_inputs))
    per_unit = factor * (2j * np.pi * frequency_hz.ravel()) ** (drive.quantity.derivative if moved else 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        value, spread = H[:, 0, j] / per_unit, sd[:, 0, j] / abs(per_unit)
    return value.reshape(frequency_hz.shape)[()], spread.reshape(frequency_hz.shape)[()]


def cycles(
    estimate: Estimate, amplitudes: Any, frequencies_hz: Any, rig: Rig | None = None
) -> tuple[Cycle, ...]:
    """Energy per cycle, equivalent stiffness and damping of elements in sines: `Estimate.cycles_at`."""
    from dashpot.estimate.cycles import cycles_at

    if estimate.values.ndim != 1:
        raise UsageError("a batch of estimates has no cycles", cure="choose one of them")
    named = {"amplitudes": amplitudes, "frequencies_hz": frequencies_hz}
    numbers = {name: np.atleast_1d(_numbers(value, name)) for name, value in named.items()}
    for name, array in numbers.items():
        if array.ndim > 1 or not np.all(array > 0):
            raise UsageError(f"{name} is {named[name]!r}", cure="give numbers above 0")
    return cycles_at(_rig_of(estimate, rig).model, estimate, *(each.tolist() for each in numbers.values()))


def predicted_motion(
    estimate: Estimate, inputs: Any, rig: Rig | None = None, **changes: float
) -> tuple[Record, ...]:
    """What the channels would show under measured or wished inputs, from rest and without noise: Records with their sd.

    inputs   a Record, or columns by name with `time_s` (a data frame, a mapping), or the name of a file
    changes  values by name, SI units, that are to be otherwise: `with_values`

    Raises DataError if an input is missing, and as `Estimate.with_values` and `simulate`.
    """
    from dashpot.study.simulate import response_band

    changed = with_exact_values(estimate, changes)
    whole = _rig_of(changed, rig)
    predicted = [response_band(whole.model, changed, whole.channels, one) for one in _inputs(whole, inputs)]
    return tuple(replace(record, sd=sd) for record, sd in predicted)


def with_exact_values(estimate: Estimate, changes: Mapping[str, float | str]) -> Estimate:
    """The estimate with these values exact and the rest as it was: `Estimate.with_values`."""
    if not changes:
        return estimate
    if estimate.values.ndim != 1:
        raise UsageError("a batch of estimates has no values to change", cure="choose one of them")
    known = {name: (value, unit) for name, value, unit in estimate.known}
    units = dict(zip(estimate.names, estimate.units, strict=True)) | {name: known[name][1] for name in known}
    given = {name: _in_si(value, name, units.get(name, "")) for name, value in changes.items()}
    for name in given.keys() - {*estimate.names, *known}:
        raise UsageError(
            f"{name} is not a parameter of the estimate that can be changed",
            cure=f"its parameters are {', '.join([*estimate.names, *known])}",
        )
    exact = np.array([name in given for name in estimate.names])
    stated = np.array([given.get(name, 0.0) for name in estimate.names])
    beside = exact | exact[:, None]
    changed = replace(
        estimate,
        values=np.where(exact, stated, estimate.values),
        free_values=np.where(exact, stated, estimate.free_values),
        bound_sd=np.where(exact, 0.0, estimate.bound_sd),
        covariance=np.where(beside, 0.0, estimate.covariance),
        noise_covariance=np.where(beside, 0.0, estimate.noise_covariance),
        known=tuple((name, given.get(name, value), unit) for name, (value, unit) in known.items()),
        profiles={name: curve for name, curve in estimate.profiles.items() if name not in given},
        stated=tuple(statement for statement in estimate.stated if statement[0] not in given),
        modes=None,
        assessment=None,
        cycles=(),
    )
    carried = changed.carried_rig()
    if carried is None:
        return changed
    model = _rig_of(changed, carried).model
    m = len(model.unknowns)
    return replace(changed, modes=linear_modes(model, changed.values[:m], changed.covariance[:m, :m]))


def report(estimate: Estimate, path: AnyPath, level: float = 0.95) -> str:
    """Write the report of an estimate as HTML, as the command does; the name of the file.

    Of an estimate that was read from JSON it has the lines that are kept there, not what more the data showed.  Raises
    UsageError for another ending and for a batch.
    """
    from dashpot.present.identification import identification_report
    from dashpot.present.page import provenance_of

    if estimate.values.ndim != 1:
        raise UsageError("a batch of estimates has no report", cure="choose one of them")
    name = os.fspath(path)
    if not name.endswith(".html"):
        raise UsageError("reports are written as .html", name, "name it so, and print that for a PDF file")
    rig = _rig_of(estimate)
    origin = estimate.origin
    with opened() as ledger:
        for file in filter(os.path.isfile, () if origin is None else (origin.rig.path, *origin.files)):
            ledger.note_read(file)
        page = identification_report(
            rig.model,
            None if origin is None else origin.spectrum,
            estimate,
            level,
            provenance_of("estimate.report(…), in Python"),
            channels=rig.all_channels,
        )
        write_text(name, page)
    return name


def text(value: Estimate | Comparison | Track) -> str:
    """What the command prints of a result."""
    from dashpot.fleet.tracking import Track
    from dashpot.present.comparison import comparison_document
    from dashpot.present.document import printed
    from dashpot.present.estimate import estimate_text

    if isinstance(value, Track):
        from dashpot.present.fleet import track_document

        return printed(track_document(value))
    return printed(comparison_document(value)) if isinstance(value, Comparison) else estimate_text(value)


def html(value: Rig | Record | Spectrum | Estimate | Comparison | Track) -> str:
    """A value as HTML, for a notebook."""
    from dashpot.fleet.tracking import Track
    from dashpot.present.comparison import comparison_document
    from dashpot.present.data import notebook_document
    from dashpot.present.document import html_of
    from dashpot.present.estimate import estimate_document

    if isinstance(value, Estimate):
        if value.values.ndim > 1:
            return f"<p>{len(value.values)} estimates</p>"
        return html_of(estimate_document(value, untried=()))
    if isinstance(value, Track):
        from dashpot.present.fleet import track_document

        return html_of(track_document(value))
    return html_of(comparison_document(value) if isinstance(value, Comparison) else notebook_document(value))


def plot(value: Estimate | Comparison | Track, level: float = 0.95, values: bool = False) -> Any:
    """A matplotlib Figure: of an estimate that keeps its lines measured against model, else values and intervals."""
    from dashpot.fleet.tracking import Track

    if isinstance(value, Track):
        from dashpot.present.figures.study import track_figure

        return track_figure(value, level)
    from dashpot.present.figures.comparison import comparison_figure, estimate_figure

    if isinstance(value, Estimate) and not values and value.assessment is not None:
        from dashpot.present.identification import fit_figure

        with suppress(DashpotError):  # where its rig is not known, or nothing depends on the estimate
            rig = _rig_of(value)
            return fit_figure(rig.model, value, rig.all_channels)
    return comparison_figure(value, level) if isinstance(value, Comparison) else estimate_figure(value, level)


@one_blas_thread()
def frf(
    data: Data,
    inputs: str | Sequence[str] | None = None,
    outputs: str | Sequence[str] | None = None,
    *,
    rig: Rig | None = None,
    band: tuple[float, float] | None = None,
    frequency_hz: float | None = None,
) -> MeasuredResponse:
    """Frequency responses of outputs to inputs with their covariance, from data of any kind and without a rig's values.

    data     as for `identify`
    inputs, outputs  names of columns; by default those of the `rig`; without a rig, all other columns are outputs
    band     lowest and highest frequency, Hz
    frequency_hz  drive frequency of time records of stepped sine without such a column

    Raises UsageError for channels that are not there, DataError if the data do not separate the inputs, are too
    short, or hold no excitation in the band.
    """
    from dashpot.free.response import frequency_response

    return frequency_response(*_without_rig(data, inputs, outputs, rig, frequency_hz), band)


@overload
def modes(data: Model, inputs: Real, /) -> Modes: ...


@overload
def modes(data: Model, /, *, p: Real) -> Modes: ...


@overload
def modes(*, model: Model, p: Real) -> Modes: ...


@overload
def modes(
    data: Data | MeasuredResponse,
    inputs: str | Sequence[str] | None = None,
    outputs: str | Sequence[str] | None = None,
    *,
    rig: Rig | None = None,
    band: tuple[float, float] | None = None,
    frequency_hz: float | None = None,
    most: int = MOST_MODES,
    real: bool = False,
) -> MeasuredModes: ...


@one_blas_thread()
def modes(
    data: Model | Data | MeasuredResponse = None,
    inputs: Any = None,
    outputs: str | Sequence[str] | None = None,
    *,
    rig: Rig | None = None,
    band: tuple[float, float] | None = None,
    frequency_hz: float | None = None,
    most: int = MOST_MODES,
    real: bool = False,
    model: Model | None = None,
    p: Real | None = None,
) -> Modes | MeasuredModes:
    """Modes from data, with standard deviations and without a rig's values; or the modes of a model.

    data     as for `frf`, or its result; records without any input are taken as free decays
    inputs, outputs, rig, band, frequency_hz  as for `frf`; with a `rig`, shapes are named after its coordinates
    most     largest number of poles
    real     hold the shapes real, up to one complex factor each

    For a Model: `modes(model, p)` with parameters p (elements,), as `dashpot.model.modes`.  Raises the errors of
    `frf`, and DataError if no mode is found.
    """
    model, p = data if isinstance(data, Model) else model, inputs if p is None else p
    if model is not None:
        if p is None:
            raise UsageError("the parameters of the model are missing", cure="call modes(model, p)")
        return eigenmodes(model, p)
    from dashpot.free.modes import measured_modes
    from dashpot.free.response import MeasuredResponse

    if isinstance(data, MeasuredResponse):
        found = measured_modes(data.in_band(band).independent(), (), (), most=most, real=real)
    else:
        named = _without_rig(data, inputs, outputs, rig, frequency_hz, driven=False)
        found = measured_modes(*named, band, most=most, real=real)
    alone = [next(iter(c.of)) if list(c.of.values()) == [1.0] else c.name for c in found.outputs]
    points = tuple(
        point if alone.count(point) == 1 else channel.name
        for channel, point in zip(found.outputs, alone, strict=True)
    )
    return found if rig is None else replace(found, points=points)


@one_blas_thread()
def track(
    rig: Rig,
    data: Data,
    window: float | str,
    *,
    speed: float | Mapping[str, float] | None = None,
    false_alarms: float = 0.01,
    conditioning: Conditioning | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Track:
    """Track the unknowns of a rig through one long record, window by window, and find when they change.

    data          a file (text and Parquet are read in pieces), Records, or columns by name
    window        length in s, or text such as "20 s"
    speed         standard deviation of the change in one hour, as a share of the value: for all unknowns, or by name
                  (the others are then constant); by default estimated
    false_alarms  share of records without a change in which one is reported
    conditioning  how windows are turned into amplitudes

    `progress(done, done)` is called after each window.  To feed windows one by one use `dashpot.Tracker`.  Raises
    DataError if the data are not a continuous record or no window determines the unknowns, UsageError for an invalid
    window, speed or share, and IdentifiabilityError if the channels do not determine the unknowns.
    """
    from dashpot.data.readers.pieces import records_in_pieces, windows_of
    from dashpot.fleet.tracking import Tracker

    seconds = quantity(window, "time") if isinstance(window, str) else float(window)
    if not 0 < seconds < float("inf"):
        raise UsageError(f"a window of {seconds:g} s", cure="give a time above 0")
    tracker = Tracker(rig, Conditioning() if conditioning is None else conditioning, seed)
    tracker.require_speed(speed)
    if isinstance(data, str | os.PathLike):
        records: Iterable[Record] = records_in_pieces(data, rig.channels)
    else:
        records = _reading(rig, data, None).records
    for one in windows_of(records, seconds):
        tracker.add(one)
        if progress is not None:
            progress(tracker.windows, tracker.windows)
    return tracker.track(speed=speed, false_alarms=false_alarms)


def _without_rig(
    data: Data,
    inputs: str | Sequence[str] | None,
    outputs: str | Sequence[str] | None,
    rig: Rig | None,
    frequency_hz: float | None,
    driven: bool = True,
) -> tuple[Reading, tuple[str, ...], tuple[str, ...]]:
    """The data by the channels that are named, those of a rig or of the data themselves; and inputs and outputs.

    Raises UsageError without an input where the test was `driven`, and without an output.
    """
    into, out = (None if some is None else names_in(some) for some in (inputs, outputs))
    several: list[Any] = [data] if isinstance(data, Spectrum | Reading) else _several(data)
    if not several:
        raise DataError("there are no data", cure="give at least one file")
    first = several[0]
    if isinstance(first, Reading):
        first = (*first.records, *([first.amplitudes] if first.amplitudes else []))[0]
    if rig is not None:
        known = {channel.name: channel for channel in rig.channels}
        drives = [name for name, channel in known.items() if measures_input(rig.model, channel)]
        into = drives if into is None else into
        out = [name for name in known if name not in (*drives, *into)] if out is None else out
    elif isinstance(first, Record | Spectrum):
        known = {channel.name: channel for channel in first.channels}
    else:
        known = channels_in([each if _is_path(each) else columns_in_memory(each, "data") for each in several])
    if not into and driven:
        cure = f"name the column that drives the rig, one of {listed(known)}"
        raise UsageError("no input is named", cure=cure)
    into = into or []
    out = [name for name in known if name not in into] if out is None else out
    if not out:
        raise UsageError("no output is named", cure=choose_from(known))
    for name in (*into, *out):
        if name not in known:
            raise UsageError(f"there is no channel {name}", cure=choose_from(known))
    if isinstance(data, Reading | Spectrum):
        return Reading((), data, ()) if isinstance(data, Spectrum) else data, tuple(into), tuple(out)
    every = dict.fromkeys([*into, *out])
    channels = tuple(known[name] for name in every)
    if rig is not None:
        reading = _reading(replace(rig, channels=channels), data, frequency_hz)
    elif all(map(_is_path, several)):
        reading = readers.read(several, channels, frequency_hz=frequency_hz)
    else:
        records = [
            [each] if isinstance(each, Record) else records_of(each, channels, frequency_hz=frequency_hz)
            for each in several
        ]
        reading = Reading(tuple(record for some in records for record in some), None, ())
    return reading, tuple(into), tuple(out)


def _is_path(data: object) -> bool:
    return isinstance(data, str | os.PathLike)


def _of_rig(
    rig: Rig | Model,
    estimate: Estimate,
    spectrum: Spectrum | None = None,
    files: tuple[str, ...] = (),
    records: Sequence[Record] = (),
) -> Estimate:
    """The estimate with its rig, the name of its file where it has one, and what it was made from; a stand's cycles."""
    model = _model(rig)
    if not model.n and not estimate.values.ndim > 1:  # a test stand
        from dashpot.estimate.cycles import cycles_of_records, cycles_of_spectrum

        cycles = (
            cycles_of_records(model, estimate, records)
            if spectrum is None
            else cycles_of_spectrum(model, estimate, spectrum)
        )
        estimate = replace(estimate, cycles=cycles)
    if isinstance(rig, Model):
        return estimate
    return replace(estimate, rig=rig.path or estimate.rig, origin=Origin(rig, spectrum, files))


def _rig_of(estimate: Estimate | None, rig: Rig | None = None) -> Rig:
    """The rig that an estimate was made of, or is said to be of, with the known values of the estimate."""
    if rig is None and estimate is not None:
        rig = estimate.carried_rig()
        if rig is None and estimate.rig is not None:
            rig = read_rig(estimate.rig)
    if estimate is None or rig is None:
        raise UsageError("the estimate does not name its rig file", cure="give the rig as well")
    return _with_known(rig, {name: value for name, value, _ in estimate.known})


def _with_known(rig: Rig, values: Mapping[str, float]) -> Rig:
    """The rig with known parameters otherwise."""
    elements = tuple(
        replace(element, value=values[element.name])
        if element.value is not None and element.sd is None and element.name in values
        else element
        for element in rig.model.elements
    )
    return (
        rig if elements == rig.model.elements else replace(rig, model=replace(rig.model, elements=elements))
    )


def _inputs(rig: Rig, data: Any) -> tuple[Record, ...]:
    """Records of the inputs of a rig, from anything that holds them."""
    alone = tuple(channel for channel in rig.channels if measures_input(rig.model, channel))
    return _reading(replace(rig, channels=alone or rig.channels), data, None).records


def _has_columns(data: object) -> bool:
    """Whether it is a table: columns by name."""
    if isinstance(data, Mapping) or (isinstance(data, np.ndarray) and data.dtype.names):
        return True
    return any(hasattr(data, name) for name in ("columns", "data_vars", "dims", "sampling_time"))


def _numbers(value: Any, name: str) -> Real:
    """Finite numbers of any shape.  Raises UsageError."""
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.array(np.nan)
    if isinstance(value, bool | bytes | str) or not np.all(np.isfinite(numbers)):
        raise UsageError(f"{name} is {value!r}", cure="give a finite number")
    return numbers


def _in_si(value: Any, name: str, unit: str) -> float:
    """A finite number, or one with a unit as text, "9 kN/m", in the SI unit of a parameter.  Raises UsageError."""
    kind = quantity_of_unit(unit)
    if not isinstance(value, str) or kind is None:
        return float(_numbers(value, name))
    try:
        return quantity(value, *kind)
    except UsageError as error:
        raise UsageError(f"{name}: {error.problems[0].what}", cure=error.problems[0].cure) from None


def _model(rig: Rig | Model) -> Model:
    return rig.model if isinstance(rig, Rig) else rig


def _spectrum(
    rig: Rig | Model,
    data: Data,
    frequency_hz: float | None,
    conditioning: Conditioning | None,
    methods: Iterable[Method | str],
) -> Spectrum:
    """Amplitudes of any data, with second moments of the samples where a method needs them and there are samples."""
    if isinstance(data, Spectrum):
        if frequency_hz is not None or conditioning is not None:
            raise UsageError(
                "a spectrum has been conditioned already", cure="leave frequency_hz and conditioning out"
            )
        return data
    reading = _reading(rig, data, frequency_hz)
    usual = Conditioning(**reading.conditioning) if conditioning is None else conditioning
    kinds = [method_class(method) if isinstance(method, str) else method for method in methods]
    return amplitudes_for(_model(rig), reading, usual, [kind.traits for kind in kinds])


def _require_measured(rig: Rig | Model, spectrum: Spectrum) -> None:
    """Raises DataError if an experiment of the rig file has no data."""
    measured = set(kind_of(spectrum.experiment).tolist())
    for kind, one in enumerate(rig.experiments if isinstance(rig, Rig) else (), 1):
        if kind in measured:
            continue
        what = f"there are no data of the experiment {one.name}"
        if one.data:
            what += f": no file is called {' or '.join(one.data)}"
        cure = f"give its files as well, or remove [experiments.{one.name}] from the rig file"
        if not one.data:
            cure = f'say which files are its own, data = "run2*.csv" below [experiments.{one.name}]'
        raise DataError(what, cure=cure)


def _reading(rig: Rig | Model, data: Data, frequency_hz: float | None) -> Reading:
    """Files read by the channels of the rig, or what was read before, with the calibrations that the rig states."""
    if isinstance(data, Reading):
        return replace(data, records=tuple(_calibrated(rig, record) for record in data.records))
    several = _several(data)
    if several and all(isinstance(item, str | os.PathLike) for item in several):
        return read(several, rig if isinstance(rig, Rig) else _channels(rig), frequency_hz=frequency_hz)
    records: list[Record] = []
    for item in several:
        if not isinstance(item, Record):
            named = rig if isinstance(rig, Rig) else _channels(rig)
            records += records_of(item, named, frequency_hz=frequency_hz, source=type(item).__name__)
        else:
            records.append(_calibrated(rig, item))
    return Reading(tuple(records), None, ())


def _several(data: Any) -> list[Any]:
    """Files, tables or Records, one or several, as a list.  Raises UsageError if they are none of these."""
    if isinstance(data, Record | str | os.PathLike) or _has_columns(data):
        return [data]
    if not isinstance(data, Sequence):
        raise UsageError(
            f"{type(data).__name__} is not data",
            cure="give the name of a file, a data frame or a mapping of columns with time_s, Records or a Spectrum",
        )
    return list(data)


def _calibrated(rig: Rig | Model, record: Record) -> Record:
    """The record, whose channels without a calibration of their own take that of the rig's channel of their name.

    Where that measures the same.
    """
    stated: dict[str, Channel] = {}
    if isinstance(rig, Rig):
        kind = record.experiment // RUNS
        own = Experiments(rig.channels, rig.experiments).named(kind if kind <= len(rig.experiments) else 0)
        stated = {channel.column: channel for channel in own}

    def as_stated(channel: Channel) -> Channel:
        other = stated.get(channel.name, channel)
        alike = (channel.of, channel.quantity) == (other.of, other.quantity)
        return other if alike and (channel.gain, channel.delay, channel.sign) == (1.0, 0.0, 1.0) else channel

    channels = tuple(map(as_stated, record.channels))
    return record if channels == record.channels else replace(record, channels=channels)


def _channels(rig: Rig | Model) -> Sequence[Channel]:
    return rig.channels if isinstance(rig, Rig) else default_channels(rig)
