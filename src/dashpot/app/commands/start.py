"""dashpot start: from data that nobody has described to a rig file."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, cast

import click

from dashpot.app import options as opt
from dashpot.app.commands.new import CHAIN, DRIVES, UNKNOWN, WEIGHED, ask_for
from dashpot.app.data_files import inspected
from dashpot.app.process import tell
from dashpot.errors import DashpotError, UsageError
from dashpot.io.atomic import write_text
from dashpot.io.toml_document import PLACEHOLDER, inline_texts
from dashpot.io.words import quoted

DRIVEN = click.Choice((*DRIVES, "stand"), case_sensitive=False)


@opt.dashpot_command("dashpot start run1.csv", "dashpot start *.csv --driven-by base --unit g --out rig.toml")
def command(
    files: Annotated[
        tuple[str, ...], opt.NEEDED_FILES, "Data files of any format, or a manifest (TOML) of them."
    ],
    out: Annotated[
        str,
        opt.Option("--out -o RIG.toml", opt.OutputFile(new=True), opt.OUTPUT, default="rig.toml"),
        "The rig file.",
    ],
    drive: Annotated[
        str | None,
        opt.Option("--driven-by", DRIVEN, CHAIN),
        "The base moves, a force acts, the masses are let go, or an element stands on a test stand.",
    ],
    unit: Annotated[
        str | None,
        opt.Option("--unit UNIT", None, CHAIN),
        "Unit of the columns that state none, such as mm or g.",
    ],
    known: Annotated[
        float | None, opt.Option("--first-mass KG", opt.MASS, CHAIN), "The first mass, if it was weighed."
    ],
    at: Annotated[
        str | None, opt.Option("--force-at NAME", None, CHAIN), "The mass that the force acts on, such as x1."
    ],
    base: Annotated[
        str | None,
        opt.Option("--base COLUMN", None, CHAIN),
        "The column of the base motion, if its name does not show it.",
    ],
    rate: Annotated[
        float | None, opt.Option("--rate HZ", opt.FREQUENCY, CHAIN), "Sampling rate of files without times."
    ],
) -> None:
    """Show what is in FILES, and write a rig file that names their columns as channels, with its drawing.

    It asks for what the data do not show.  Without a terminal it writes "?", and the next command names the line.
    """
    from dashpot.check.first_rig import first_rig, seen_data
    from dashpot.data.readers.manifest import files_named, is_manifest
    from dashpot.data.readers.modes import holds_modes
    from dashpot.model.rigfile.writer import STAND_IN, starter_text

    manifest, picture = (str(Path(out).with_name(Path(out).stem + end)) for end in ("-data.toml", ".svg"))
    for beside in filter(os.path.exists, (manifest, picture)):
        raise UsageError(
            "a file of this name exists", beside, "choose another name for --out, or remove this one"
        )
    paths = [path for name in files for path in files_named(name)]
    for path in filter(holds_modes, paths):
        cure = "write a rig file by hand or with dashpot new; identify reads the modes"
        raise UsageError("this file contains modes, no channels", str(path), cure)
    inspections = inspected(files)
    seen, ask = seen_data(inspections), ask_for()
    columns = []
    for column in seen.columns:
        if column.unit is None:
            said = unit if unit and column.may_be_in(unit) else ask(f"Unit of {column.name}", PLACEHOLDER)
            column = column if said == PLACEHOLDER else column.in_unit(said)
        columns.append(column)
    seen = replace(seen, columns=tuple(columns))
    drive = drive or ("base" if base else "force" if at else None)
    drive = drive or (seen.drive if seen.sure else ask("What drives it", seen.drive, DRIVEN))
    chain = first_rig(
        seen,
        f"Rig of {os.path.basename(paths[0])}" if len(paths) == 1 else "My rig",
        cast(Any, drive),
        known,
        at,
        base,
    )
    if chain.lacks_scale and (first := ask("Mass of x1, if it was weighed", UNKNOWN, WEIGHED)) != UNKNOWN:
        chain = replace(chain, known=first)
    if chain.at == PLACEHOLDER:
        places = click.Choice((*(f"x{i + 1}" for i in range(chain.masses)), PLACEHOLDER))
        chain = replace(chain, at=ask("Mass that the force acts on", PLACEHOLDER, places))
    data = list(files)
    if (seen.renamed or not seen.timed) and not any(map(is_manifest, files)):
        if not seen.timed:
            rate = rate or ask("Sampling rate, Hz", PLACEHOLDER, opt.FREQUENCY.or_words(PLACEHOLDER))
        _write_manifest(manifest, list(map(str, paths)), None if seen.timed else rate, seen.renamed)
        data = [manifest]
    text = starter_text(chain)
    write_text(out, text)
    if chain.lacks_scale:
        tell(
            f"No force is measured, so one mass must be known. m1 = {STAND_IN:g} kg in {out} is a PLACEHOLDER: "
            "replace it with the weighed mass.",
            err=False,
        )
    if chain.masses > 1:
        tell(
            "The masses are assumed to be in a row, in the order of the columns, the last next to the base. "
            "If that is wrong, edit `between` in the file.",
            err=False,
        )
    _tell(out, picture, text, data)


def _write_manifest(
    manifest: str, paths: Sequence[str], rate: float | str | None, renamed: Mapping[str, Mapping[str, str]]
) -> None:
    """A manifest of the files with their rate (None: they have times) and columns, and what it says of them."""
    of_all = os.path.commonpath([Path(path).resolve().parent for path in paths])
    folder = os.path.relpath(of_all, Path(manifest).resolve().parent)
    entries = [f"folder = {quoted(Path(folder).as_posix())}\n"] if folder != "." else []
    for path in paths:
        lines = ["[[files]]", f"name = {quoted(Path(path).resolve().relative_to(of_all).as_posix())}"]
        if rate is not None:
            lines.append(f"rate_hz = {quoted(rate) if isinstance(rate, str) else repr(rate)}")
        if names := renamed.get(path):
            columns = inline_texts(names)
            lines.append(f"columns = {columns}")
            taken = f"they are taken to be the same channels: {columns}"
            tell(f"The columns of {path} have other names than those of {paths[0]}; {taken}.", err=False)
        entries.append("\n".join(lines) + "\n")
    write_text(manifest, "\n".join(entries))
    where = (
        "in it the sampling rate has to be written" if rate == PLACEHOLDER else "correct it if it is wrong"
    )
    click.echo(f"Written: {manifest}; {where}.")


def _tell(out: str, picture: str, text: str, data: Sequence[str]) -> None:
    """What was written, what can be found with it, and what is next; or what has to be filled in first."""
    from dashpot.api import check, draw
    from dashpot.check.deficiencies import require_full_rank
    from dashpot.model.rigfile import parse_rig
    from dashpot.present.check import structure_in_words

    try:
        rig = parse_rig(text, out)
    except DashpotError as error:
        click.echo(f"Written: {out}. Fill in what is not known yet:")
        for problem in error.problems:
            click.echo(f"  {problem}")
        return
    draw(rig).save(picture)
    verdict = check(rig)
    try:
        require_full_rank(verdict, rig.model, rig.all_channels, out)
        for line in structure_in_words(verdict, [channel.name for channel in rig.channels], None):
            tell(line, err=False)
    except DashpotError as error:
        for problem in error.problems:
            tell(f"Cannot be found yet: {problem}", err=False)
    names = " ".join(f"'{name}'" if " " in name else name for name in data)
    tell(f"Written: {out} and its drawing, {picture}. Next: dashpot identify {out} {names}", err=False)
