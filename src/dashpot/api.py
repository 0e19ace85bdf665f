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
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dashpot.channel import Channel
from dashpot.check.identifiability import Structure, structure
from dashpot.data import readers
from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.modal_data import ModalData
from dashpot.data.readers import Reading
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError, UsageError
from dashpot.estimate import comparison as comparisons
from dashpot.estimate import identify as identification
from dashpot.estimate.amplitudes import amplitudes_for
from dashpot.estimate.automatic import identify_with_noise
from dashpot.estimate.comparison import Comparison
from dashpot.estimate.likelihood.settling import with_settling_decided
from dashpot.estimate.method import Method
from dashpot.estimate.nonlinear.whole_record import fit_records
from dashpot.estimate.registry import method as named_method
from dashpot.estimate.registry import methods_for
from dashpot.estimate.result import Estimate
from dashpot.export.identified_rig import IdentifiedRig, identified_rig
from dashpot.export.state_space import StateSpace, state_space_of
from dashpot.export.transfer_functions import TransferFunctions, transfer_functions_of
from dashpot.model.network import Model
from dashpot.model.rigfile import Rig, default_channels, read_rig
from dashpot.quantities import frequencies as frequencies_of
from dashpot.study.simulate import dwells, simulate_records

if TYPE_CHECKING:
    from dashpot.present.schematic.drawing import Drawing
    from dashpot.present.schematic.moving import ModeDrawing

AnyPath = str | os.PathLike[str]
Data = Spectrum | Reading | Record | AnyPath | Sequence[Record] | Sequence[AnyPath]
Progress = Callable[[int, int], None]


def read(
    paths: AnyPath | Sequence[AnyPath],
    channels: Sequence[Channel] | Rig,
    *,
    frequency_hz: float | None = None,
) -> Reading:
    """Read data files; `channels` says what their columns are: those of a rig, or a list.

    `frequency_hz` is the drive frequency of time records without such a column.  Raises DataError, one problem for
    each cause, with file, row and column.
    """
    listed = channels.channels if isinstance(channels, Rig) else channels
    return readers.read(paths, listed, frequency_hz=frequency_hz)


def identify(
    rig: Rig | Model,
    data: Data,
    method: Method | str | None = None,
    *,
    frequency_hz: float | None = None,
    conditioning: Conditioning | None = None,
    diagnose: bool = False,
    progress: Progress | None = None,
) -> Estimate:
    """Estimate the unknowns of a rig from data.

    rig     a Rig, or a Model, whose channels are then its coordinates and inputs in SI units
    data    a Spectrum (with batch axes: repeats of one test), files by name, Records, or what `read` returned
    method  a method or its name, such as "ml"; without one the most precise that suits the data is chosen
    frequency_hz, conditioning  of time records: their drive frequency, and how they become amplitudes
    diagnose  judge the fit and, where it fails, look for causes, as the command does (no batch axes): `print` tells

    `progress(done, all)` is called between chunks of repeats.  Raises DataError or UsageError where the data lack what
    the method needs, IdentifiabilityError where they do not determine the unknowns, ConvergenceError where no search
    comes to an end, ModelError where the rig has no steady response.
    """
    chosen = named_method(method) if isinstance(method, str) else method
    if not isinstance(data, Spectrum):
        data = _reading(rig, data, frequency_hz)
        if data.continuous and len(_model(rig).nonlinear):
            return _of_nonlinear_records(
                rig, data, None if chosen is None else chosen.name, conditioning, diagnose, progress
            )
    spectrum = _spectrum(rig, data, frequency_hz, conditioning, [] if chosen is None else [chosen])
    from dashpot.present.text.identifiability import require_identifiable

    model = _model(rig)
    where = rig.path or None if isinstance(rig, Rig) else None
    require_identifiable(model, spectrum.channels, where, spectrum)
    spectrum = with_settling_decided(model, spectrum, chosen)
    suited = identification.automatic(model, spectrum) if chosen is None else chosen
    estimate, spectrum = identify_with_noise(
        model, spectrum, suited, chosen=chosen is not None, progress=progress
    )
    if diagnose:
        from dashpot.check.diagnosis.diagnose import examined

        estimate = examined(model, spectrum, estimate)
    return _of_rig(rig, estimate)


def _of_nonlinear_records(
    rig: Rig | Model,
    reading: Reading,
    method: str | None,
    conditioning: Conditioning | None,
    diagnose: bool,
    progress: Progress | None,
) -> Estimate:
    """The estimate from continuous records of a nonlinear rig, judged if asked for."""
    from dashpot.check.diagnosis.record_channels import require_sound_channels

    model = _model(rig)
    still = None if conditioning is None else conditioning.still
    require_sound_channels(model, reading.records)
    fitted = fit_records(model, reading.records, method, still=still, progress=progress)
    estimate = fitted.estimate()
    if diagnose:
        from dashpot.check.record_verdict import examined_records

        estimate = examined_records(model, reading.records, estimate, fitted)
    return _of_rig(rig, estimate)


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

    `data` as of `identify`, None where there are only measured modes (`modal`); `truth` by name in SI units;
    `refused` are methods that were ruled out before, with the reason.  Raises as `identify` where no method gives
    anything, and UsageError where `truth` names what is not an unknown.
    """
    model = _model(rig)
    if methods is None:
        methods = methods_for(model)
    if not isinstance(methods, Mapping):
        methods = {name: named_method(name, seed=seed) for name in methods}
    spectrum = (
        None if data is None else _spectrum(rig, data, frequency_hz, conditioning, list(methods.values()))
    )
    return comparisons.compare(
        model, spectrum, methods if spectrum is not None else {}, modal=modal, refused=refused, truth=truth, seed=seed,
        progress=progress,
    )  # fmt: skip


def check(
    rig: Rig, data: Data | None = None, *, frequency_hz: float | None = None, seed: int = 0
) -> Structure:
    """Whether the unknowns of a rig can be found from its channels and, with data, from their frequencies.

    Raises IdentifiabilityError where the rig has no steady response, DataError where the data do not suit the rig.
    """
    spectrum = None if data is None else _spectrum(rig, data, frequency_hz, None, [])
    return structure(rig.model, rig.channels if spectrum is None else spectrum.channels, spectrum, seed)


def simulate(
    rig: Rig,
    values: Mapping[str, float],
    frequencies: str | Sequence[float],
    *,
    samples: int = 200,
    amplitudes: Mapping[str, complex] | None = None,
    periods: float = 10.0,
    rate: float | None = None,
    seed: int = 0,
) -> tuple[Record, ...]:
    """The stepped-sine records that a rig would yield, with the noise that its channels state: one for each dwell.

    values       of the unknowns by name, SI units; guesses of the rig file stand in for what is not given
    frequencies  Hz: a sequence, or as the command line has them ("1:10:0.5", "1:10/25")
    samples      of each dwell, spread over `periods`, or taken at `rate` (Hz)
    amplitudes   of the inputs by name, SI units; 1 where not given

    Raises UsageError where an unknown has no value or an input does not exist, ModelError where the rig has no steady
    response, DataError where a channel measures what the rig has not.
    """
    chosen = frequencies_of(frequencies) if isinstance(frequencies, str) else frequencies
    model = rig.model
    test = dwells(model, chosen, samples, amplitudes=amplitudes, periods=periods, rate=rate)
    p = model.parameters(model.theta(values))
    return tuple(simulate_records(model, p, rig.channels, test, np.random.default_rng(seed)))


def draw(
    rig: Rig | Model, estimate: Estimate | None = None, *, mode: int | None = None, level: float = 0.95
) -> Drawing | ModeDrawing:
    """The rig as a schematic: a value that notebooks show and `save("rig.svg")` writes (.svg, .png or .pdf).

    estimate  whose values and intervals at `level` stand beside the elements
    mode      the number of a mode that is drawn in their place, 1 the slowest: of the estimate, or of the values and
              guesses that the rig states

    Raises UsageError where the rig has too many bodies for a drawing, or no such mode, ModelError or DataError where
    the rig or its channels cannot be.
    """
    from dashpot.check.doubt import doubtful, undetermined
    from dashpot.present.schematic.drawing import schematic
    from dashpot.present.schematic.moving import mode_drawing, numbered_mode

    model, channels = _model(rig), _channels(rig)
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
    """The state space of a rig from its inputs to its channels, SI units, calibrations left out.

    rig, source  a rig and its estimate, or values of the unknowns by name; an estimate alone stands for the rig file
                 that it names
    given        as what displacement inputs are given, "displacement", "velocity" or "acceleration", of all or by
                 name; else as they are measured, differentiated as often as it takes to make all channels proper

    Raises ModelError for nonlinear and hysteretic elements and coordinates without mass, UsageError where values are
    missing or `given` is not possible, DataError where the estimate is of another rig.
    """
    return state_space_of(_identified(rig, source), given)


def transfer_functions(
    rig: Rig | Estimate,
    source: Estimate | Rig | Mapping[str, float] | None = None,
    *,
    given: str | Mapping[str, str] | None = None,
) -> TransferFunctions:
    """Poles, zeros, gains and polynomials from each input to each channel.

    SI units; arguments, and what is raised, as of `state_space`.
    """
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
    data         measured data as of `identify`, of which frequency responses are written (.uff)

    Other arguments as of `state_space`.  Raises UsageError for an unknown ending, ModelError where the format cannot
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
    """A rig with values, whichever way round they are given."""
    estimate = rig if isinstance(rig, Estimate) else source if isinstance(source, Estimate) else None
    whole = rig if isinstance(rig, Rig) else source if isinstance(source, Rig) else None
    if whole is None:
        if estimate is None or estimate.rig is None:
            raise UsageError("the estimate does not name its rig file", cure="give the rig as well")
        whole = read_rig(estimate.rig)
    values = source if isinstance(source, Mapping) else None
    return identified_rig(whole, estimate, values)


def text(value: Estimate | Comparison) -> str:
    """What the command prints of a result."""
    from dashpot.present.tables.comparison import show_comparison
    from dashpot.present.tables.estimate import estimate_text
    from dashpot.present.tables.layout import printed

    if isinstance(value, Comparison):
        return printed(lambda out: show_comparison(out, value))
    return estimate_text(value)


def html(value: Rig | Record | Spectrum | Estimate | Comparison) -> str:
    """A value as HTML, for a notebook."""
    from dashpot.present.tables import spectrum as tables
    from dashpot.present.tables.comparison import comparison_html
    from dashpot.present.tables.estimate import estimate_html

    if isinstance(value, Estimate):
        return estimate_html(value) if value.values.ndim == 1 else f"<p>{len(value.values)} estimates</p>"
    if isinstance(value, Comparison):
        return comparison_html(value)
    if isinstance(value, Rig):
        return tables.rig_html(value)
    return tables.record_html(value) if isinstance(value, Record) else tables.spectrum_html(value)


def plot(value: Estimate | Comparison, level: float = 0.95) -> Any:
    """A matplotlib Figure of the values with their intervals."""
    from dashpot.present.figures.comparison import comparison_figure, estimate_figure

    return comparison_figure(value, level) if isinstance(value, Comparison) else estimate_figure(value, level)


def _of_rig(rig: Rig | Model, estimate: Estimate) -> Estimate:
    """The estimate with the name of its rig file, where it has one."""
    return replace(estimate, rig=rig.path) if isinstance(rig, Rig) and rig.path else estimate


def _model(rig: Rig | Model) -> Model:
    return rig.model if isinstance(rig, Rig) else rig


def _spectrum(
    rig: Rig | Model,
    data: Data,
    frequency_hz: float | None,
    conditioning: Conditioning | None,
    methods: Sequence[Method],
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
    return amplitudes_for(_model(rig), reading, usual, [method.traits for method in methods])


def _reading(
    rig: Rig | Model,
    data: Reading | Record | AnyPath | Sequence[Record] | Sequence[AnyPath],
    frequency_hz: float | None,
) -> Reading:
    """Files read by the channels of the rig, or what was read before."""
    if isinstance(data, Reading):
        return data
    several = [data] if isinstance(data, Record | str | os.PathLike) else list(data)
    records = [item for item in several if isinstance(item, Record)]
    if records and len(records) == len(several):
        return Reading(tuple(records), None, ())
    paths = [item for item in several if not isinstance(item, Record)]
    return read(paths, _channels(rig), frequency_hz=frequency_hz)


def _channels(rig: Rig | Model) -> Sequence[Channel]:
    return rig.channels if isinstance(rig, Rig) else default_channels(rig)
