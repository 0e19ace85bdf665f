"""dashpot check: what of a rig can be found, before data and with them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dashpot.app.files import STDOUT
from dashpot.app.help import dashpot_command, option
from dashpot.app.options import (
    DATA_HELP,
    conditioning_options,
    data_argument,
    json_option,
    level_option,
    quiet_option,
    rig_argument,
    seed_option,
    whole_record_options,
)
from dashpot.app.parameter_types import names

if TYPE_CHECKING:
    from dashpot.check.identifiability import Structure
    from dashpot.data.spectrum import Spectrum
    from dashpot.model.rigfile import Rig

WITH_DATA = "With DATA"


@dashpot_command(
    "check",
    "dashpot check rig.toml",
    "dashpot check rig.toml data.csv --known --profile c1",
)
@rig_argument
@data_argument(DATA_HELP)
@option(
    "--profile", "profiled", multiple=True, metavar="NAME,…", group=WITH_DATA,
    help="Interval of an unknown from the profile likelihood, beside the normal one.  May be repeated.",
)  # fmt: skip
@option(
    "--known", is_flag=True, group=WITH_DATA,
    help="How much an error of each known parameter moves each estimate.",
)  # fmt: skip
@json_option("the findings")
@level_option
@conditioning_options
@whole_record_options
@seed_option("the random numbers")
@quiet_option
def command(
    rig: str, data: tuple[str, ...], profiled: tuple[str, ...], known: bool, json_out: str | None, level: float,
    seed: int, quiet: bool, **conditioning: Any,
) -> int:  # fmt: skip
    """Check whether the unknowns of RIG can be found from its channels and, with DATA, which ones only poorly.

    Exit codes: 0 all can be found; 2 bad usage, model or data; 3 some cannot: each line says which combinations can be
    found and what would help.
    """
    from dashpot.app.data_files import read_spectrum
    from dashpot.app.files import write_result
    from dashpot.app.progress import progress
    from dashpot.check.identifiability import structure
    from dashpot.check.nonlinear_structure import nonlinear_structure
    from dashpot.errors import UsageError
    from dashpot.io.json_document import to_json
    from dashpot.model.rigfile import read_rig
    from dashpot.present.content.check import structure_content
    from dashpot.present.text.identifiability import require_full_rank

    if (profiled or known) and not data:
        raise UsageError("--profile and --known need data", cure="name the data files after the rig file")
    rig_read = read_rig(rig)
    rig_read.model.require_unknowns(rig)
    spectrum = read_spectrum(rig_read, data, conditioning, quiet) if data else None
    channels = rig_read.channels if spectrum is None else spectrum.channels
    with progress("check", quiet):
        if len(rig_read.model.nonlinear):
            verdict = nonlinear_structure(rig_read.model, channels, spectrum)
        else:
            verdict = structure(rig_read.model, channels, spectrum, seed)
    content = structure_content(rig_read.model, channels, verdict)
    parts: list[Any] = []
    if verdict.identifiable and spectrum is not None:
        wanted = [name for text in profiled for name in names(text)]
        with progress("check", quiet):
            parts = _with_data(rig_read, spectrum, content, wanted, known, level, seed)
    write_result(json_out, to_json(content))
    require_full_rank(verdict, rig_read.model, channels, rig)
    if not quiet and json_out != STDOUT:
        _show(verdict, [channel.name for channel in channels], spectrum, parts)
    return 0


def _show(
    verdict: Structure, channels: Sequence[str], spectrum: Spectrum | None, parts: Sequence[Any]
) -> None:
    from dashpot.present.tables.check import show_known, show_paragraphs
    from dashpot.present.tables.layout import console
    from dashpot.present.text.check import structure_in_words

    out = console()
    show_paragraphs(out, structure_in_words(verdict, channels, None if spectrum is None else spectrum.lines))
    for part in parts:
        out.print()
        if isinstance(part, list):
            show_paragraphs(out, part)
        else:
            show_known(out, part)


def _with_data(
    rig: Rig,
    spectrum: Spectrum,
    content: dict[str, Any],
    profiled: Sequence[str],
    known: bool,
    level: float,
    seed: int,
) -> list[Any]:
    """What the data say: paragraphs and tables to print; the same goes into `content`."""
    from dashpot.check.chi2_surface import chi2_surface
    from dashpot.check.collinearity import collinearity
    from dashpot.check.profile import profile
    from dashpot.check.sensitivity import known_errors
    from dashpot.estimate.identify import automatic, identify
    from dashpot.estimate.registry import method
    from dashpot.present.content.check import collinearity_content, known_content, profile_content
    from dashpot.present.text.check import collinearity_in_words, profile_in_words

    estimate = identify(rig.model, spectrum, method(automatic(rig.model, spectrum).name, seed=seed))
    weak = collinearity(chi2_surface(rig.model, spectrum, estimate), estimate.covariance)
    content["data"] = collinearity_content(weak, spectrum)
    units = dict(zip(estimate.names, estimate.units, strict=True))
    parts: list[Any] = [collinearity_in_words(weak, spectrum, units)]
    if profiled:
        profiles = [profile(rig.model, spectrum, name, level, estimate) for name in profiled]
        content["profiles"] = [profile_content(one) for one in profiles]
        parts.append([profile_in_words(one) for one in profiles])
    if known:
        errors = known_errors(rig.model, spectrum, estimate)
        content["known_errors"] = known_content(errors)
        parts.append(errors)
    return parts
