"""dashpot simulate: the test data that a rig with given parameters would yield."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import click

from dashpot.app.options import (
    AMPLITUDE,
    FREQUENCIES,
    FREQUENCY,
    INPUT_FILE,
    NUMBER,
    VALUES,
    Count,
    dashpot_command,
    option,
    out_option,
    quiet_option,
    relative_noise_option,
    rig_argument,
    seed_option,
    set_option,
)
from dashpot.errors import printable

if TYPE_CHECKING:
    from numpy.random import Generator

    from dashpot.arrays import Real
    from dashpot.channel import Channel
    from dashpot.data.record import Record
    from dashpot.model.network import Model
    from dashpot.model.rigfile import Rig
    from dashpot.quantities import Amount
    from dashpot.study.simulate import Dwells

TEST = "The test"
NOISE = "Noise"


@dashpot_command(
    "simulate",
    "dashpot simulate rig.toml --set m1=3,c1=20,c2=30 --frequencies 1:10:0.5 --out data.csv",
    "dashpot simulate rig.toml --frequencies 0.5:25/40log --amplitude u=2mm --table -o amplitudes.csv",
    "dashpot simulate rig.toml --estimate estimate.json --input shaker.csv --out predicted.csv",
    "dashpot simulate rig.toml --input shaker.csv --out record.csv",
)
@rig_argument
@set_option("The rig", "values", VALUES)
@option(
    "--frequencies",
    type=FREQUENCIES,
    metavar="LIST|RANGE",
    group=TEST,
    help="Frequencies in Hz: a list 1,2,5, start:stop:step, or start:stop/points (start:stop/pointslog on a "
    "logarithmic scale).",
)
@option(
    "--input", "input_file", type=INPUT_FILE, metavar="FILE", group=TEST,
    help="In place of --frequencies: a record whose input channels drive the rig from rest, of any excitation.",
)  # fmt: skip
@option(
    "--estimate",
    type=INPUT_FILE,
    metavar="FILE.json",
    group="The rig",
    help="Take the values of an estimate, with --input: writes its prediction without noise, and the uncertainty of "
    "each predicted output as NAME_sd.",
)
@option(
    "--samples", type=Count(4, 100_000_000), default=200, show_default=True, metavar="N", group=TEST,
    help="Samples of each dwell.",
)  # fmt: skip
@option(
    "--rate",
    type=FREQUENCY,
    metavar="HZ",
    group=TEST,
    help="Sampling rate.  [default: the samples spread over --periods]",
)
@option(
    "--periods", type=NUMBER, default="10", show_default=True, metavar="N", group=TEST,
    help="Periods of each dwell, where no rate is given.",
)  # fmt: skip
@option(
    "--amplitude", "amplitudes", type=AMPLITUDE, multiple=True, metavar="[INPUT=]VALUE", group=TEST,
    help="Amplitude of all inputs (2mm, 10N) or of one (u=2mm).  May be repeated.  [default: 1 m, rad, N or N·m]",
)  # fmt: skip
@relative_noise_option(NOISE)
@seed_option("the noise")
@out_option("FILE.csv", "The file to write.")
@option(
    "--table", is_flag=True, group="Output", help="Write complex amplitudes with their noise, not samples."
)
@quiet_option
def command(
    rig: str, out: str, values: Sequence[Mapping[str, Amount]], frequencies: tuple[float, ...] | None,
    input_file: str | None, estimate: str | None, samples: int, rate: float | None, periods: float, seed: int,
    amplitudes: Sequence[Amount | Mapping[str, Amount]], relative_noise: float | None, table: bool, quiet: bool,
) -> None:  # fmt: skip
    """Write the test data that RIG would yield: stepped sine, or its motion under a record of its inputs.

    Every unknown needs a value: from --set, or the value or guess of the rig file.  Each channel gets
    the noise that the rig file states for it: `noise` (in its unit) and `relative_noise`.
    """
    from dashpot.app.parameters import input_amplitudes, merged, parameter_values
    from dashpot.app.progress import progress
    from dashpot.model.rigfile import read_rig

    _check_test(frequencies, input_file, table)
    rig_read = read_rig(rig)
    if estimate is not None:
        _write_prediction(rig_read, estimate, input_file, bool(values), out, quiet)
        return
    model, values_si = rig_read.model, parameter_values(rig_read, merged(values, "--set"))
    require_values(rig_read, values_si)
    drive = input_amplitudes(model, amplitudes)
    if frequencies is not None:
        _require_drive(rig_read, drive)

    import numpy as np

    from dashpot.data.readers import write_records
    from dashpot.model.observation import with_relative_noise
    from dashpot.study import simulate as study

    channels = rig_read.channels
    if relative_noise is not None:
        channels = with_relative_noise(model, channels, relative_noise)
    theta, rng = model.theta(values_si), np.random.default_rng(seed)
    if frequencies is None:
        from dashpot.study.simulate import driven_record

        with progress("simulate", quiet):
            record = driven_record(model, theta, channels, _input_record(rig_read, str(input_file)), rng)
            write_records([record], out)
        what = f"{len(record.time)} samples"
    else:
        test = study.dwells(model, frequencies, samples, amplitudes=drive, periods=periods, rate=rate)
        with progress("simulate", quiet):
            _write_dwells(model, theta, channels, test, rng, table, out)
        many = "1 frequency" if len(frequencies) == 1 else f"{len(frequencies)} frequencies"
        what = f"{many}, {'amplitudes' if table else f'{samples} samples at each'}"
    if not quiet:
        click.echo(f"{printable(out)}: {what}; channels {', '.join(c.name for c in channels)}")


def _write_prediction(
    rig: Rig, estimate: str, input_file: str | None, with_values: bool, out: str, quiet: bool
) -> None:
    """The response that an estimate predicts, with its standard deviation.  Raises UsageError and DataError."""
    from dashpot.app.progress import progress
    from dashpot.data.readers import write_records
    from dashpot.errors import UsageError
    from dashpot.estimate.result import Estimate
    from dashpot.study.simulate import response_band

    if input_file is None or with_values:
        raise UsageError(
            "an estimate predicts the response to a record",
            cure="give --input, and no --set beside --estimate",
        )
    with progress("simulate", quiet):
        inputs = _input_record(rig, input_file)
        predicted, sd = response_band(rig.model, Estimate.load(estimate), rig.channels, inputs)
    write_records([predicted], out, [sd])
    if not quiet:
        names = ", ".join(channel.name for channel in rig.channels)
        click.echo(
            f"{printable(out)}: {len(predicted.time)} samples; channels {names}, with ± of the estimate as NAME_sd"
        )


def _check_test(frequencies: tuple[float, ...] | None, input_file: str | None, table: bool) -> None:
    """One of --frequencies and --input.  Raises UsageError."""
    from dashpot.errors import UsageError

    if (frequencies is None) == (input_file is None):
        what = "nothing drives the rig" if frequencies is None else "the rig is driven in two ways"
        raise UsageError(what, cure="give --frequencies, or --input with a record of the inputs")
    if table and frequencies is None:
        raise UsageError("--table is for stepped sine", cure="leave it out, or give --frequencies")


def _input_record(rig: Rig, path: str) -> Record:
    """The record of the inputs.  Raises DataError where the file holds dwells, amplitudes or several records."""
    from dashpot.data.readers import read
    from dashpot.errors import DataError
    from dashpot.model.observation import measures_input

    reading = read([path], [c for c in rig.channels if measures_input(rig.model, c)])
    if len(reading.records) != 1 or reading.records[0].frequency_hz is not None:
        raise DataError(
            "the inputs are not one continuous record",
            path,
            "give a table with time_s and the input channels",
        )
    return reading.records[0]


def _write_dwells(
    model: Model,
    theta: Real,
    channels: Sequence[Channel],
    test: Dwells,
    rng: Generator,
    table: bool,
    out: str,
) -> None:
    """Settled dwells, sample by sample or as a table; those of a nonlinear rig with their harmonics."""
    from dashpot.data.readers import write_amplitudes, write_records
    from dashpot.study import simulate as study

    if len(model.nonlinear):
        from dashpot.study.simulate import settled_motion, settled_records, settled_spectrum

        motion = settled_motion(model, theta, channels, test)
        if table:
            write_amplitudes(settled_spectrum(motion, test, rng), out)
        else:
            write_records(settled_records(motion, test, rng), out)
        return
    p = model.parameters(theta)
    if table:
        write_amplitudes(study.simulate_spectrum(model, p, channels, test, rng, drift=1), out)
    else:
        write_records(study.simulate_records(model, p, channels, test, rng), out)


def _require_drive(rig: Rig, drive: Mapping[str, complex]) -> None:
    """Raises UsageError where an input of a nonlinear rig has no amplitude: its motion is not proportional to it."""
    from dashpot.errors import UsageError

    missing = [given.name for given in rig.model.inputs if given.name not in drive]
    if len(rig.model.nonlinear) and missing:
        raise UsageError(
            "the motion of a rig with nonlinear elements depends on the size of its drive",
            rig.path,
            f"add --amplitude {missing[0]}=1mm or whatever drives it",
        )


def require_values(rig: Rig, values: Mapping[str, float]) -> None:
    """Every unknown needs a value.  Raises UsageError with all that have none."""
    from dashpot.errors import Problem, UsageError

    missing = [
        u.name for u in rig.model.unknowns if u.name not in values and u.prior is None and u.guess is None
    ]
    problems = [
        Problem(f"{name} has no value", rig.path, f"add --set {name}=1.0, or a guess in the rig file")
        for name in missing
    ]
    if problems:
        raise UsageError(problems)
