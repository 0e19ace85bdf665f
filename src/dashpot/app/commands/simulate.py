"""dashpot simulate: the test data that a rig with given parameters would yield."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from dashpot.app.files import InputFile, OutputFile
from dashpot.app.options import Positive, Setting

if TYPE_CHECKING:
    from dashpot.channel import Channel
    from dashpot.model.network import Model


class Frequencies(click.ParamType[tuple[float, ...]]):
    """1,2,5 or 0.5:25:40 (from, to and count, evenly on a logarithmic scale; 0.5:25:40lin evenly)."""

    name = "hz,hz,…"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """The frequencies, Hz."""
        text = str(value).strip()
        linear = text.endswith("lin")
        parts = text.removesuffix("lin").split(":")
        try:
            if len(parts) == 3:
                first, last, count = float(parts[0]), float(parts[1]), int(parts[2])
                if not (2 <= count <= 1_000_000 and 0 < first < last < 1e12):
                    raise ValueError
                steps = [k / (count - 1) for k in range(count)]
                if linear:
                    return tuple(first + (last - first) * step for step in steps)
                return tuple(first * (last / first) ** step for step in steps)
            found = tuple(float(part) for part in text.split(","))
        except ValueError:
            found = ()
        if len(parts) != 1 or not found or not all(0 < f < 1e12 for f in found):
            self.fail(
                f"{text!r} names no frequencies; write 1,2,5 or 0.5:25:40 (from:to:count, in Hz)", param, ctx
            )
        return found


@click.command(name="simulate")
@click.argument("rig", type=InputFile())
@click.option("--out", type=OutputFile(), metavar="FILE.csv", required=True, help="The file to write.")
@click.option(
    "--set", "values", type=Setting(), multiple=True, metavar="NAME=VALUE",
    help="Value of an unknown, SI units; repeat it for each.  Guesses of the rig file serve where nothing is set.",
)  # fmt: skip
@click.option(
    "--frequencies", type=Frequencies(), required=True, metavar="HZ,HZ,…|FROM:TO:COUNT[lin]",
    help="Frequencies, Hz: a list, or a range (logarithmic, or lin).",
)  # fmt: skip
@click.option(
    "--samples", type=click.IntRange(4, 100_000_000), default=200, show_default=True, help="Of a dwell."
)
@click.option(
    "--rate", type=Positive(1e12), metavar="HZ", help="Sampling rate; else the samples spread over --periods."
)
@click.option(
    "--periods",
    type=Positive(1e9),
    default=10.0,
    show_default=True,
    help="Of a dwell, where no rate is given.",
)
@click.option(
    "--amplitude", "amplitudes", type=Setting(), multiple=True, metavar="INPUT=VALUE",
    help="Amplitude of an input, m (or rad, N); 1 where not given.",
)  # fmt: skip
@click.option(
    "--relative-noise", type=click.FloatRange(0, 1e6), metavar="PART",
    help="Noise of a sample over the amplitude, of all channels but inputs, in place of the rig file's.",
)  # fmt: skip
@click.option("--table", is_flag=True, help="Write complex amplitudes with their noise instead of samples.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the noise.")
@click.option("--quiet", "-q", is_flag=True, help="Print nothing.")
def command(
    rig: str,
    out: str,
    values: Sequence[tuple[str, float]],
    frequencies: tuple[float, ...],
    samples: int,
    rate: float | None,
    periods: float,
    amplitudes: Sequence[tuple[str, float]],
    relative_noise: float | None,
    table: bool,
    seed: int,
    quiet: bool,
) -> None:
    """Write the stepped-sine test that RIG would yield, with the noise that its channels state.

    Every unknown needs a value: by --set, or a guess in the rig file.  A channel's noise is `noise` (in its unit) and
    `relative_noise` of the rig file.
    """
    from dashpot.model.rigfile import read_rig

    found = read_rig(rig)
    model = found.model
    given = _once(values, "--set")
    _check_values(model, given, rig)
    theta = model.theta(given)

    import numpy as np

    from dashpot.data.readers import write_amplitudes, write_records
    from dashpot.model.observation import with_relative_noise
    from dashpot.study import simulate as study

    channels: tuple[Channel, ...] = found.channels
    if relative_noise is not None:
        channels = with_relative_noise(model, channels, relative_noise)
    test = study.dwells(
        model,
        frequencies,
        samples,
        amplitudes=dict(_once(amplitudes, "--amplitude")),
        periods=periods,
        rate=rate,
    )
    p, rng = model.parameters(theta), np.random.default_rng(seed)
    if table:
        write_amplitudes(study.simulate_spectrum(model, p, channels, test, rng, drift=1), out)
    else:
        write_records(study.simulate_records(model, p, channels, test, rng), out)
    if not quiet:
        what = "amplitudes" if table else f"{samples} samples each"
        click.echo(f"{out}: {len(frequencies)} frequencies, {what}, of {', '.join(c.name for c in channels)}")


def _once(settings: Sequence[tuple[str, float]], option: str) -> dict[str, float]:
    from dashpot.errors import UsageError

    found = dict(settings)
    if len(found) < len(settings):
        names = [name for name, _ in settings]
        twice = next(name for name in names if names.count(name) > 1)
        raise UsageError(f"{option} gives {twice} twice", cure="give it once")
    return found


def _check_values(model: Model, given: dict[str, float], rig: str) -> None:
    """Every unknown needs a value, and nothing else may have one.  Raises UsageError with all problems."""
    from dashpot.errors import Problem, UsageError

    unknown = {one.name: one for one in model.unknowns}
    elements = {element.name for element in model.elements}
    problems = []
    for name in given:
        if name in elements and name not in unknown:
            what, cure = (
                f"--set {name}: the rig file gives its value",
                "change it there, or leave it out here",
            )
            problems.append(Problem(what, rig, cure))
        elif name not in unknown:
            what, cure = f"--set {name}: there is no such unknown", f"there are {', '.join(unknown)}"
            problems.append(Problem(what, rig, cure))
    for name, one in unknown.items():
        if name not in given and one.prior is None and one.guess is None:
            cure = f"add --set {name}=1.0, or a guess in the rig file"
            problems.append(Problem(f"{name} has no value", rig, cure))
    if problems:
        raise UsageError(problems)
