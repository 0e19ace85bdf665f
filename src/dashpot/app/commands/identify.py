"""dashpot identify: from a rig file and test data to parameters with intervals."""

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
    tell_notes,
)

if TYPE_CHECKING:
    from dashpot.data.conditioning.settings import Conditioning
    from dashpot.data.readers import Reading
    from dashpot.data.spectrum import Spectrum
    from dashpot.estimate.method import Method
    from dashpot.estimate.result import Estimate
    from dashpot.model.rigfile import Rig

CHOICES = ["auto", "ls", "hls", "wls", "tls", "cls", "iv", "oiv", "oiv+", "ml"]


@click.command(name="identify")
@click.argument("rig", type=InputFile())
@click.argument("data", type=InputFile(), nargs=-1, required=True)
@click.option(
    "--method", "chosen", type=click.Choice(CHOICES), default="auto", show_default=True,
    help="Estimator; auto is oiv where every coordinate and input is measured and nothing bounded, ml elsewhere.",
)  # fmt: skip
@click.option(
    "--positive", is_flag=True, help="Hold every unknown but entries of free matrices at or above 0; by ml."
)
@click.option(
    "--json",
    "json_out",
    type=OutputFile(stdout=True),
    metavar="OUT",
    help="Write the estimate as JSON; - is stdout.",
)
@click.option(
    "--report", type=OutputFile(), metavar="OUT.html", help="Write a report with figures, one HTML file."
)
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    metavar="N",
    help="Of the starts that ml draws.",
)
@click.option(
    "--level",
    type=Positive(100),
    default=95,
    show_default=True,
    metavar="%",
    help="Of the intervals printed.",
)
@click.option("--matrices", is_flag=True, help="Print M, C and K as well, as for a rig with free matrices.")
@conditioning_options
@click.option("--quiet", "-q", is_flag=True, help="Print no table and no notes.")
def command(
    rig: str,
    data: tuple[str, ...],
    chosen: str,
    positive: bool,
    json_out: str | None,
    report: str | None,
    seed: int,
    level: float,
    frequency: float | None,
    matrices: bool,
    quiet: bool,
    **how: Any,
) -> int:
    """Find the unknown masses, dampers and springs of RIG (a rig.toml) from DATA.

    DATA are CSV files of time records (frequency_hz, time_s, channels) or of complex amplitudes (frequency_hz,
    NAME_re, NAME_im, NAME_sd).  Exit code 3: the data do not determine the unknowns, or the iteration did not settle.
    """
    from dashpot.check.identifiability import require_identifiable
    from dashpot.check.scale import require_scale_seen
    from dashpot.io.atomic import write_text
    from dashpot.model.rigfile import read_rig

    found = read_rig(rig)
    found.model.require_unknowns(rig)
    chosen = _holding(chosen, positive)
    _check_matrices(found, matrices)
    require_identifiable(found.model, found.channels, rig)
    if chosen != "auto":
        require_scale_seen(chosen, found.model, found.channels, rig)

    from dashpot.app.progress import progress
    from dashpot.data.readers import read
    from dashpot.estimate.identify import identify

    reading = read(data, found.channels, frequency_hz=frequency)
    tell_notes(reading.notes, quiet)
    conditioning = conditioning_from(how)
    spectrum = _spectrum(reading, conditioning, chosen, quiet)
    require_identifiable(found.model, spectrum.channels, rig, spectrum)
    with progress("identify", quiet) as moved:
        estimate = identify(
            found.model, spectrum, _method(chosen, found, spectrum, seed, positive), progress=moved
        )
    if report is not None:
        from dashpot.present.pages.report import identification_report

        page = identification_report(found.model, spectrum, estimate, level / 100, [rig, *data])
        write_text(report, page)
    if json_out == STDOUT:
        click.echo(estimate.to_json(), nl=False)
    elif json_out is not None:
        write_text(json_out, estimate.to_json())
    if not quiet and json_out != STDOUT:
        from dashpot.present.tables.estimate import console, show_estimate

        show_estimate(console(), estimate, level / 100)
        if matrices or _of_free_matrices(found):
            _show_matrices(found, estimate)
    return _ending(estimate)


def _of_free_matrices(rig: Rig) -> bool:
    """Whether M, C and K are free and tell all of the rig: hysteretic dampers are in none of them."""
    from dashpot.model.unstructured import free_names

    model = rig.model
    return bool(free_names(model)) and not len(model.by_matrix["H"])


def _show_matrices(rig: Rig, estimate: Estimate) -> None:
    from dashpot.estimate.linear.definite import matrices_of
    from dashpot.present.tables.estimate import console
    from dashpot.present.tables.matrices import show_matrices

    show_matrices(console(), matrices_of(rig.model, estimate), set(rig.model.coordinates) <= rig.model.angles)


def _check_matrices(rig: Rig, wanted: bool) -> None:
    """Refuse --matrices, before the work, where they do not tell all of the rig."""
    from dashpot.errors import UsageError

    if wanted and len(rig.model.by_matrix["H"]):
        raise UsageError("hysteretic dampers are in none of M, C and K", "--matrices", "leave the option out")
    if wanted and 0 < len(rig.model.angles & set(rig.model.coordinates)) < rig.model.n:
        raise UsageError(
            "matrices of displacements and angles together have no one unit",
            "--matrices",
            "leave the option out",
        )


def _spectrum(reading: Reading, conditioning: Conditioning, chosen: str, quiet: bool) -> Spectrum:
    """Amplitudes; with the second moments of the samples where the paper's least squares asks for them."""
    samples = chosen == "ls" and reading.amplitudes is None
    return amplitudes(reading, conditioning, quiet, moments=samples)


def _holding(chosen: str, positive: bool) -> str:
    """The method: ml where unknowns are to be held at or above 0."""
    from dashpot.errors import UsageError

    if positive and chosen not in ("auto", "ml"):
        raise UsageError(
            f"the method {chosen} holds no bounds", cure="leave out --positive, or use the method ml"
        )
    return "ml" if positive else chosen


def _method(chosen: str, rig: Rig, spectrum: Spectrum, seed: int, positive: bool) -> Method:
    from dashpot.estimate.identify import automatic
    from dashpot.estimate.registry import method

    name = automatic(rig.model, spectrum).name if chosen == "auto" else chosen
    return method(name, seed=seed, positive=positive)


def _ending(estimate: Estimate) -> int:
    """The exit code, and a line where the iteration has not settled."""
    if bool(estimate.converged):
        return 0
    cure = (
        'check signs and units of the channels (a wrong one shows where all have gain = "unknown" but one), '
        "give the unknowns a guess, or try another --method"
    )
    click.echo(
        f"dashpot: {estimate.method} did not settle in {int(estimate.iterations)} iterations; {cure}",
        err=True,
    )
    return NOT_CONVERGED
