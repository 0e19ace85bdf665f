"""dashpot check: what of a rig can be found, before data and with them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from dashpot.app.files import STDOUT, InputFile, OutputFile
from dashpot.app.options import (
    Positive,
    amplitudes,
    conditioning_from,
    conditioning_options,
    tell_notes,
)

if TYPE_CHECKING:
    from dashpot.data.conditioning.settings import Conditioning
    from dashpot.data.spectrum import Spectrum
    from dashpot.model.rigfile import Rig


@click.command(name="check")
@click.argument("rig", type=InputFile())
@click.argument("data", type=InputFile(), nargs=-1)
@click.option(
    "--profile", "profiled", multiple=True, metavar="NAME",
    help="Profile likelihood of an unknown and its interval; needs DATA.  May be repeated.",
)  # fmt: skip
@click.option(
    "--known", is_flag=True, help="How errors of the known parameters move each unknown; needs DATA."
)
@click.option(
    "--json",
    "json_out",
    type=OutputFile(stdout=True),
    metavar="OUT",
    help="Write the findings as JSON; - is stdout.",
)
@click.option("--level", type=Positive(100), default=95, show_default=True, metavar="%", help="Of intervals.")
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, metavar="N", help="Of random draws."
)
@conditioning_options
@click.option("--quiet", "-q", is_flag=True, help="Print nothing but what is wrong.")
def command(
    rig: str,
    data: tuple[str, ...],
    profiled: tuple[str, ...],
    known: bool,
    json_out: str | None,
    level: float,
    seed: int,
    frequency: float | None,
    quiet: bool,
    **how: Any,
) -> int:
    """Say whether the unknowns of RIG can be found from its channels, and, with DATA, which ones badly.

    Exit code 3: some cannot; each line says which combinations can and what would help.
    """
    from dashpot.check.identifiability import structure
    from dashpot.check.report import structure_content
    from dashpot.errors import IdentifiabilityError, UsageError
    from dashpot.io.atomic import write_text
    from dashpot.io.json_document import to_json
    from dashpot.model.rigfile import read_rig

    if (profiled or known) and not data:
        raise UsageError("--profile and --known need data", cure="name the data files after the rig")
    found = read_rig(rig)
    found.model.require_unknowns(rig)
    channels, spectrum = found.channels, None
    if data:
        conditioning = conditioning_from(how)
        spectrum = _read(found, data, frequency, conditioning, quiet)
        channels = spectrum.channels
    verdict = structure(found.model, channels, spectrum, seed)
    content = structure_content(found.model.name, verdict)
    told: list[Any] = []
    if verdict.identifiable and spectrum is not None:
        told = _with_data(found, spectrum, content, profiled, known, level / 100, seed)
    text = to_json(content)
    if json_out == STDOUT:
        click.echo(text, nl=False)
    elif json_out is not None:
        write_text(json_out, text)
    if not verdict.identifiable:
        raise IdentifiabilityError(verdict.problems(rig))
    if not quiet and json_out != STDOUT:
        from dashpot.present.tables.check import show_known, show_paragraphs, structure_in_words
        from dashpot.present.tables.estimate import console

        out, names = console(), [channel.name for channel in channels]
        show_paragraphs(out, structure_in_words(verdict, names, None if spectrum is None else spectrum.lines))
        for part in told:
            out.print()
            if isinstance(part, list):
                show_paragraphs(out, part)
            else:
                show_known(out, part)
    return 0


def _read(
    rig: Rig, data: tuple[str, ...], frequency: float | None, conditioning: Conditioning, quiet: bool
) -> Spectrum:
    from dashpot.data.readers import read

    reading = read(data, rig.channels, frequency_hz=frequency)
    tell_notes(reading.notes, quiet)
    return amplitudes(reading, conditioning, quiet)


def _with_data(
    rig: Rig,
    spectrum: Spectrum,
    content: dict[str, Any],
    profiled: tuple[str, ...],
    known: bool,
    level: float,
    seed: int,
) -> list[Any]:
    """What the data say: paragraphs and tables to print; the same goes into `content`."""
    from dashpot.check.chi2_surface import surface
    from dashpot.check.collinearity import weakness
    from dashpot.check.profile import profile
    from dashpot.check.report import known_content, profile_content, weakness_content
    from dashpot.check.sensitivity import known_errors
    from dashpot.estimate.identify import automatic, identify
    from dashpot.estimate.registry import method
    from dashpot.present.tables.check import profile_in_words, weakness_in_words

    estimate = identify(rig.model, spectrum, method(automatic(rig.model, spectrum).name, seed=seed))
    weak = weakness(surface(rig.model, spectrum, estimate), estimate.covariance)
    content["data"] = weakness_content(weak, spectrum)
    units = dict(zip(estimate.names, estimate.units, strict=True))
    told: list[Any] = [weakness_in_words(weak, spectrum, units)]
    if profiled:
        profiles = [profile(rig.model, spectrum, name, level, estimate) for name in profiled]
        content["profiles"] = [profile_content(one) for one in profiles]
        told.append([profile_in_words(one) for one in profiles])
    if known:
        errors = known_errors(rig.model, spectrum, estimate)
        content["known_errors"] = known_content(errors)
        told.append(errors)
    return told
