"""dashpot simulate: the test data that a rig with given parameters would yield."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import click
import numpy as np

from dashpot.app import options as opt
from dashpot.app.options import changed_values, coordinate_amounts, input_amplitudes, parameter_values
from dashpot.app.workers import progress
from dashpot.errors import DataError, UsageError, printable
from dashpot.quantities import Amount

if TYPE_CHECKING:
    from dashpot.data.record import Record
    from dashpot.model.rigfile import Rig

TEST = "The test"


@opt.dashpot_command(
    "dashpot simulate rig.toml --set m1=3,c1=20,c2=30 --frequencies 1:10:0.5 --out data.csv",
    "dashpot simulate rig.toml --frequencies 0.5:25/40log --amplitude u=2mm --table -o amplitudes.csv",
    "dashpot simulate rig.toml --estimate estimate.json --input shaker.csv --out predicted.csv",
    "dashpot simulate rig.toml --input shaker.csv --out record.csv",
    "dashpot simulate rig.toml --release x1=5mm --samples 800 --rate 200 --out decay.csv",
)
def command(
    rig: opt.RigFile,
    values: Annotated[tuple[dict[str, Amount], ...], opt.SET, opt.VALUES],
    frequencies: Annotated[
        tuple[float, ...] | None,
        opt.Option("--frequencies LIST|RANGE", opt.FREQUENCIES, TEST),
        "Frequencies in Hz: a list 1,2,5, start:stop:step, or start:stop/points (start:stop/pointslog on a "
        "logarithmic scale).",
    ],
    input_file: Annotated[
        str | None,
        opt.Option("--input FILE", opt.INPUT_FILE, TEST),
        "Instead of --frequencies: a record whose input channels drive the rig from rest, with any excitation.",
    ],
    release: Annotated[
        tuple[dict[str, Amount], ...],
        opt.Option("--release COORDINATE=VALUE,…", opt.AMOUNTS, TEST, multiple=True),
        "In place of --frequencies: let the rig go from where it is held, such as x1=5mm; --samples at --rate.",
    ],
    estimate: Annotated[
        str | None,
        opt.Option("--estimate FILE.json", opt.INPUT_FILE, "The rig"),
        "Take the values of an estimate, with --input: writes its prediction without noise, and the uncertainty of "
        "each predicted output as NAME_sd.  With --set the values named there are exact, the others as estimated.",
    ],
    samples: Annotated[
        int, opt.Option("--samples N", opt.Count(4, 100_000_000), TEST, default=200), "Samples of each dwell."
    ],
    rate: Annotated[
        float | None,
        opt.Option("--rate HZ", opt.FREQUENCY, TEST),
        "Sampling rate.  [default: the samples spread over --periods]",
    ],
    periods: Annotated[
        float,
        opt.Option("--periods N", opt.NUMBER, TEST, default="10"),
        "Periods of each dwell, where no --rate is given.",
    ],
    amplitudes: Annotated[
        tuple[Amount | dict[str, Amount], ...],
        opt.Option("--amplitude [INPUT=]VALUE", opt.AMPLITUDE, TEST, multiple=True),
        "Amplitude of all inputs (2mm, 10N) or of one (u=2mm).  May be repeated.  [default: as large as the [shaker] "
        "of the rig file can; without one 10 mm and 1 g at most, or 10 N]",
    ],
    relative_noise: opt.RelativeNoise,
    seed: Annotated[int, opt.SEED, "the noise"],
    out: Annotated[
        str,
        opt.Option("--out -o FILE.csv", opt.OutputFile(), opt.OUTPUT, required=True),
        "The file to write.",
    ],
    table: Annotated[
        bool,
        opt.Option("--table", None, opt.OUTPUT),
        "Write complex amplitudes with their noise, not samples.",
    ],
    experiment: opt.Experiment,
    quiet: opt.Quiet,
) -> None:
    """Write the test data that RIG would yield: stepped sine, its motion under a record of its inputs, or a free decay.

    Every unknown needs a value: from --set, or the value or guess of the rig file.  Each channel gets
    the noise that the rig file states for it: `noise` (in its unit) and `relative_noise`.
    """
    from dashpot.api import predicted_motion, simulate
    from dashpot.arrays import random_generator
    from dashpot.data.readers import write_amplitudes, write_records
    from dashpot.estimate.result import Estimate
    from dashpot.model.observation import with_relative_noise
    from dashpot.model.rigfile import read_rig
    from dashpot.model.rigfile.rig import usual_limits
    from dashpot.study import simulate as study

    drives = sum([frequencies is not None, input_file is not None, bool(release)])
    if drives != 1:
        what = "two drives are given" if drives else "no drive is given"
        raise UsageError(what, cure="give --frequencies, --input with a record of the inputs, or --release")
    if release and rate is None:
        raise UsageError("a release has no sampling rate", cure="give --rate, such as --rate 200")
    if table and frequencies is None:
        raise UsageError("--table is for stepped sine", cure="leave it out, or give --frequencies")
    read = read_rig(rig)
    read = read.in_experiment(experiment) if estimate is None else read.standing_in(experiment)
    told = ""
    if estimate is not None:
        if input_file is None:
            raise UsageError("an estimate predicts the response to a record", cure="give --input as well")
        found = Estimate.load(estimate)
        changes = changed_values({name: value.unit for name, value in found.parameters().items()}, values)
        with progress("simulate", quiet):
            [predicted] = predicted_motion(found, _input_record(read, input_file), read, **changes)
        assert predicted.sd is not None
        write_records([predicted], out, [predicted.sd])
        what, told = f"{len(predicted.time)} samples", ", with ± of the estimate as NAME_sd"
    else:
        given = parameter_values(read, values, whole=True)
        drive = input_amplitudes(read.model, amplitudes)
        if relative_noise is not None:
            noisy = with_relative_noise(read.model, read.channels, relative_noise)
            read = replace(read, channels=noisy)
        how: dict[str, Any] = {"amplitudes": drive, "periods": periods, "rate": rate}
        if release:
            held = coordinate_amounts(read.model, release)
            with progress("simulate", quiet):
                write_records(simulate(read, given, release=held, samples=samples, rate=rate, seed=seed), out)
            what = f"{samples} samples from the release on"
        elif frequencies is None:
            with progress("simulate", quiet):
                records = simulate(read, given, _input_record(read, str(input_file)), seed=seed)
                write_records(records, out)
            what = f"{len(records[0].time)} samples"
        else:
            _require_drive(read, drive)
            if read.shaker is None and read.model.inputs and len(drive) < len(read.model.inputs):
                shaker = usual_limits(read.model)
                read = replace(read, shaker=shaker)
                told = f"; no [shaker] in the rig file: {shaker.text(read.model)} at most"
            with progress("simulate", quiet):
                if table:
                    model, channels, rng = read.model, read.channels, random_generator(seed)
                    theta = model.theta(given)
                    if read.shaker is not None:
                        within = (read.shaker, frequencies, drive)
                        how["amplitudes"] = study.amplitudes_within(model, theta, *within)
                    test = study.dwells(model, frequencies, samples, **how)
                    if len(model.nonlinear):
                        motion = study.settled_motion(model, theta, channels, test)
                        spectrum = study.settled_spectrum(channels, motion, test)
                        spectrum = study.with_noise_drawn(spectrum, rng)
                    else:
                        p = model.parameters(theta)
                        spectrum = study.simulate_spectrum(model, p, channels, test, rng, drift=1)
                    write_amplitudes(spectrum, out)
                else:
                    write_records(simulate(read, given, frequencies, samples=samples, seed=seed, **how), out)
            if read.shaker is not None and drive:
                told += _beyond(read, drive, frequencies)
            many = "1 frequency" if len(frequencies) == 1 else f"{len(frequencies)} frequencies"
            what = f"{many}, {'amplitudes' if table else f'{samples} samples at each'}"
    if not quiet:
        names = ", ".join(channel.name for channel in read.channels)
        click.echo(f"{printable(out)}: {what}; channels {names}{told}")


def _input_record(rig: Rig, path: str) -> Record:
    """The record of the inputs.  Raises DataError if the file holds dwells, amplitudes or several records."""
    from dashpot.data.readers import read
    from dashpot.model.observation import measures_input

    reading = read([path], [c for c in rig.channels if measures_input(rig.model, c)])
    if len(reading.records) != 1 or reading.records[0].frequency_hz is not None:
        raise DataError(
            "the inputs are not one continuous record",
            path,
            "give a table with time_s and the input channels",
        )
    return reading.records[0]


def _beyond(rig: Rig, drive: Mapping[str, float], frequencies: Sequence[float]) -> str:
    """That a stated amplitude of a moved input is more than the shaker can; empty where it is not."""
    assert rig.shaker is not None
    omega = 2 * np.pi * np.asarray(frequencies, dtype=float)
    for name in (each for each in rig.model.displacement_inputs if each in drive):
        motion = np.full((len(omega), 1), drive[name], dtype=complex)
        use = rig.shaker.use(omega, motion, 0 * motion)
        if np.max(use) > 1 + 1e-9:
            at = frequencies[int(np.argmax(use))]
            return f"; {name} is {np.max(use):.3g} × the shaker limit at {at:g} Hz"
    return ""


def _require_drive(rig: Rig, drive: Mapping[str, complex]) -> None:
    """Raises UsageError if an input of a nonlinear rig has no amplitude: its motion is not proportional to it."""
    missing = [given.name for given in rig.model.inputs if given.name not in drive and rig.shaker is None]
    if len(rig.model.nonlinear) and missing:
        raise UsageError(
            "the response of a rig with nonlinear elements depends on the drive level",
            rig.path,
            f"add --amplitude {missing[0]}=1mm (or your value), or [shaker] to the rig file",
        )
