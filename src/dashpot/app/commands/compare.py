"""dashpot compare: the same data through several methods, one table and one picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from dashpot.app.files import STDOUT, InputFile, OutputFile
from dashpot.app.options import (
    NOT_CONVERGED,
    Positive,
    amplitudes,
    conditioning_from,
    conditioning_options,
    named_number,
    tell_notes,
)

if TYPE_CHECKING:
    from dashpot.data.modal_data import ModalData
    from dashpot.data.spectrum import Spectrum
    from dashpot.model.rigfile import Rig


class Assignments(click.ParamType[Any]):
    """NAME=VALUE, several of them separated by commas."""

    name = "name=value,…"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> dict[str, float]:
        """Values by name."""
        if isinstance(value, dict):
            return value
        found: dict[str, float] = {}
        for part in str(value).split(","):
            name, number = named_number(part)
            if not name or not abs(number) < float("inf"):
                self.fail(f"{part.strip()!r} is no NAME=VALUE; write m1=3,c1=30", param, ctx)
            if name in found:
                self.fail(f"{name} is given twice", param, ctx)
            found[name] = number
        return found


@click.command(name="compare")
@click.argument("rig", type=InputFile())
@click.argument("data", type=InputFile(), nargs=-1)
@click.option(
    "--methods", metavar="A,B,…",
    help="Estimators, in the order of the rows: ls, hls, wls, tls, cls, iv, oiv, oiv+, ml.  Default: all that suit.",
)  # fmt: skip
@click.option(
    "--modal", "modal_file", type=InputFile(), metavar="FILE",
    help="Measured modes, CSV or JSON: frequency_hz, frequency_sd, damping_ratio, damping_sd, NAME_re, _im, _sd.",
)  # fmt: skip
@click.option(
    "--truth",
    type=Assignments(),
    metavar="m1=3,…",
    help="True values, to be marked where an interval misses them.",
)
@click.option("--figure", type=OutputFile(), metavar="OUT.png", help="Draw the intervals.")
@click.option(
    "--json",
    "json_out",
    type=OutputFile(stdout=True),
    metavar="OUT",
    help="Write all estimates as JSON; - is stdout.",
)
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, metavar="N",
    help="Of the starts that ml and the modes draw.",
)  # fmt: skip
@click.option(
    "--level", type=Positive(100), default=95, show_default=True, metavar="%", help="Of the intervals."
)
@conditioning_options
@click.option("--quiet", "-q", is_flag=True, help="Print no table and no notes.")
def command(
    rig: str,
    data: tuple[str, ...],
    methods: str | None,
    modal_file: str | None,
    truth: dict[str, float] | None,
    figure: str | None,
    json_out: str | None,
    seed: int,
    level: float,
    frequency: float | None,
    quiet: bool,
    **how: Any,
) -> int:
    """Find the unknowns of RIG from DATA with several methods, side by side.

    DATA as for identify; with --modal FILE they may be left out.  A method that the data do not suit is named with
    the reason.  Exit code 3: a method did not converge.
    """
    from dashpot.errors import UsageError
    from dashpot.estimate.registry import METHODS, method_class
    from dashpot.model.rigfile import read_rig
    from dashpot.model.unstructured import free_entries

    if not data and modal_file is None:
        raise UsageError("there are no data", cure="give DATA, --modal FILE, or both")
    if methods is not None and not data:
        raise UsageError(
            "methods work on DATA, and there are none", "--methods", "give DATA, or leave it out"
        )
    chosen = [] if methods is None else [name.strip() for name in methods.split(",")]
    for name in chosen:
        method_class(name)
        if chosen.count(name) > 1:
            raise UsageError(f"{name} is named twice", "--methods", "name each method once")
    found = read_rig(rig)
    found.model.require_unknowns(rig)
    chosen = chosen or [name for name in METHODS if name != "oiv+" or free_entries(found.model)]
    modal = _modes(modal_file, found)
    spectrum = _spectrum(data, found, chosen, frequency, quiet, how) if data else None
    return _compare(found, spectrum, modal, chosen, truth, figure, json_out, seed, level / 100, quiet)


def _modes(path: str | None, rig: Rig) -> ModalData | None:
    if path is None:
        return None
    from dashpot.data.readers.delimited.modes import read_modes

    return read_modes(path, rig.model.coordinates)


def _spectrum(
    data: tuple[str, ...],
    rig: Rig,
    chosen: list[str],
    frequency: float | None,
    quiet: bool,
    how: dict[str, Any],
) -> Spectrum:
    """Amplitudes; with the second moments of the samples where ls is asked for and there are samples."""
    from dashpot.check.scale import require_scale
    from dashpot.data.readers import read

    require_scale(rig.model, rig.channels, rig.path)
    reading = read(data, rig.channels, frequency_hz=frequency)
    tell_notes(reading.notes, quiet)
    conditioning = conditioning_from(how)
    return amplitudes(reading, conditioning, quiet, moments="ls" in chosen and reading.amplitudes is None)


def _compare(
    rig: Rig,
    spectrum: Spectrum | None,
    modal: ModalData | None,
    chosen: list[str],
    truth: dict[str, float] | None,
    figure: str | None,
    json_out: str | None,
    seed: int,
    level: float,
    quiet: bool,
) -> int:
    from dashpot.app.progress import progress
    from dashpot.check.scale import require_scale_seen
    from dashpot.errors import DashpotError
    from dashpot.estimate.comparison import compare
    from dashpot.estimate.registry import method
    from dashpot.io.atomic import write_bytes, write_text

    jobs, refused = {}, {}
    for name in chosen:
        try:
            require_scale_seen(name, rig.model, rig.channels)
            jobs[name] = method(name, seed=seed)
        except DashpotError as error:
            refused[name] = error
    with progress("compare", quiet) as moved:
        found = compare(
            rig.model, spectrum, jobs, modal=modal, refused={} if spectrum is None else refused,
            truth=truth, seed=seed, progress=moved,
        )  # fmt: skip
    if figure is not None:
        from dashpot.present.figures.comparison import comparison_figure
        from dashpot.present.figures.study import png

        write_bytes(figure, png(comparison_figure(found, level)))
    if json_out == STDOUT:
        click.echo(found.to_json(), nl=False)
    elif json_out is not None:
        write_text(json_out, found.to_json())
    if not quiet and json_out != STDOUT:
        from dashpot.present.tables.comparison import show_comparison
        from dashpot.present.tables.estimate import console

        show_comparison(console(), found, level)
    unsettled = [name for name, estimate in found.estimates.items() if not bool(estimate.converged)]
    if unsettled:
        click.echo(
            f"dashpot: {', '.join(unsettled)} did not settle; do not use these values: "
            "check signs and units of the channels, or the noise is too large",
            err=True,
        )
        return NOT_CONVERGED
    return 0
