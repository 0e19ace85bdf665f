"""dashpot simulate: the test data that a rig with given parameters would yield."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import click

from dashpot.app.help import dashpot_command, option
from dashpot.app.options import out_option, quiet_option, rig_argument, seed_option
from dashpot.app.parameter_types import (
    AMOUNTS,
    AMPLITUDE,
    FREQUENCIES,
    FREQUENCY,
    NUMBER,
    SHARE_OR_ZERO,
    Count,
)
from dashpot.errors import printable

if TYPE_CHECKING:
    from dashpot.model.rigfile import Rig
    from dashpot.quantities import Amount

TEST = "The test"
NOISE = "Noise"


@dashpot_command(
    "simulate",
    "dashpot simulate rig.toml --set m1=3,c1=20,c2=30 --frequencies 1:10:0.5 --out data.csv",
    "dashpot simulate rig.toml --frequencies 0.5:25/40log --amplitude u=2mm --table -o amplitudes.csv",
)
@rig_argument
@option(
    "--set", "values", type=AMOUNTS, multiple=True, metavar="NAME=VALUE,…", group="The rig",
    help="Values of the unknowns, such as m1=3,k1=4.6kN/m; a bare number is in SI units.  May be repeated.  Unknowns "
    "that are not set take the guess or value of the rig file.",
)  # fmt: skip
@option(
    "--frequencies", type=FREQUENCIES, required=True, metavar="LIST|RANGE", group=TEST,
    help="Frequencies in Hz: a list 1,2,5, start:stop:step, or start:stop/points (start:stop/pointslog on a "
    "logarithmic scale).",
)  # fmt: skip
@option(
    "--samples", type=Count(4, 100_000_000), default=200, show_default=True, metavar="N", group=TEST,
    help="Samples of each dwell.",
)  # fmt: skip
@option(
    "--rate", type=FREQUENCY, metavar="HZ", group=TEST,
    help="Sampling rate.  [default: the samples spread over --periods]",
)  # fmt: skip
@option(
    "--periods", type=NUMBER, default="10", show_default=True, metavar="N", group=TEST,
    help="Periods of each dwell, where no rate is given.",
)  # fmt: skip
@option(
    "--amplitude", "amplitudes", type=AMPLITUDE, multiple=True, metavar="[INPUT=]VALUE", group=TEST,
    help="Amplitude of all inputs (2mm, 10N) or of one (u=2mm); may be repeated.  [default: 1 m, rad, N or N·m]",
)  # fmt: skip
@option(
    "--relative-noise", type=SHARE_OR_ZERO, metavar="5%", group=NOISE,
    help="Noise of a sample as a share of the amplitude, for every output, in place of the rig file's noise.",
)  # fmt: skip
@seed_option("the noise")
@out_option("FILE.csv", "The file to write.")
@option(
    "--table", is_flag=True, group="Output", help="Write complex amplitudes with their noise, not samples."
)
@quiet_option
def command(
    rig: str, out: str, values: Sequence[Mapping[str, Amount]], frequencies: tuple[float, ...], samples: int,
    rate: float | None, periods: float, amplitudes: Sequence[Amount | Mapping[str, Amount]],
    relative_noise: float | None, table: bool, seed: int, quiet: bool,
) -> None:  # fmt: skip
    """Write the stepped-sine test data that RIG would yield, with the noise that its channels state.

    Every unknown needs a value: from --set, or the value or guess of the rig file.  The noise of a channel is its
    `noise` (in its unit) and its `relative_noise` in the rig file.
    """
    from dashpot.app.parameters import input_amplitudes, merged, parameter_values
    from dashpot.model.rigfile import read_rig

    rig_read = read_rig(rig)
    model = rig_read.model
    values_si = parameter_values(rig_read, merged(values, "--set"))
    _require_all(rig_read, values_si)
    drive = input_amplitudes(model, amplitudes)

    import numpy as np

    from dashpot.data.readers import write_amplitudes, write_records
    from dashpot.model.channel_noise import with_relative_noise
    from dashpot.study import simulate as study

    channels = rig_read.channels
    if relative_noise is not None:
        channels = with_relative_noise(model, channels, relative_noise)
    test = study.dwells(model, frequencies, samples, amplitudes=drive, periods=periods, rate=rate)
    p, rng = model.parameters(model.theta(values_si)), np.random.default_rng(seed)
    if table:
        write_amplitudes(study.simulate_spectrum(model, p, channels, test, rng, drift=1), out)
    else:
        write_records(study.simulate_records(model, p, channels, test, rng), out)
    if not quiet:
        what = "amplitudes" if table else f"{samples} samples at each"
        many = "1 frequency" if len(frequencies) == 1 else f"{len(frequencies)} frequencies"
        click.echo(f"{printable(out)}: {many}, {what}; channels {', '.join(c.name for c in channels)}")


def _require_all(rig: Rig, values: Mapping[str, float]) -> None:
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
