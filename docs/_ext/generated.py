"""Pages that follow from the code: options of every command, notices, units, and the gallery, made by running it."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import shutil
import tempfile
import textwrap
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path

import click
import page_commands
from sphinx.application import Sphinx

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent
FRAGMENTS, GALLERY = DOCS / "_generated", DOCS / "gallery"
WIDTH = "80"
LONG = "<!-- long -->"  # of README files: its commands run in the long tests


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("config-inited", lambda *_: generate())
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def generate() -> None:
    """Write what the pages include, and the pages of the gallery; files whose text stays are left alone."""
    _write(FRAGMENTS / "options.md", options())
    _write(FRAGMENTS / "notices.md", notices())
    _write(FRAGMENTS / "units.md", units())
    folders = sorted((ROOT / "examples").glob("[0-9]*"))
    spawn = get_context("spawn")
    with ProcessPoolExecutor(max_workers=2, mp_context=spawn, initializer=_as_on_a_terminal) as pool:
        for _ in pool.map(_example, folders):
            pass


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def _cell(text: str) -> str:
    """Prose in a cell of a table; placeholders and stars are no mark-up."""
    return re.sub(r"([|*<>\[\]{}$_])", r"\\\1", " ".join(text.split()))


# ---------------------------------------------------------------- options


def options() -> str:
    """A section for every command: synopsis, what it does, arguments and options by group, examples."""
    from dashpot.app.cli import cli
    from dashpot.app.commands import COMMANDS

    parent = click.Context(cli, info_name="dashpot")
    sections = []
    for name in COMMANDS:
        command = import_module(f"dashpot.app.commands.{name}").command
        context = click.Context(command, info_name=name, parent=parent)
        sections.append(_command(command, context))
    return "\n".join(sections)


def _command(command: click.Command, context: click.Context) -> str:
    usage = " ".join([context.command_path, *command.collect_usage_pieces(context)])
    lines = [f"## {context.info_name}", "", f"```text\n{usage}\n```", ""]
    for paragraph in (command.help or "").replace("\b", "").split("\n\n"):
        lines += [_cell(paragraph), ""]
    arguments = [p for p in command.get_params(context) if isinstance(p, click.Argument)]
    if arguments:
        rows = [(p.make_metavar(context), getattr(p, "help", None) or "") for p in arguments]
        lines += _table("argument", rows)
    groups: dict[str, list[tuple[str, str]]] = {}
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context) if isinstance(parameter, click.Option) else None
        if record is not None:
            groups.setdefault(getattr(parameter, "group", "General"), []).append(record)
    groups["General"] = groups.pop("General", [])
    lines += [f"```{{program}} {context.command_path}", "```", ""]
    for title, rows in groups.items():
        lines += [f"**{title}**", ""]
        for names, text in rows:  # each a target of links and of the search, #cmdoption-dashpot-identify-band
            lines += [f"```{{option}} {names}", _cell(text), "```", ""]
    examples = getattr(command, "examples", ())
    if examples:
        lines += ["```text", *examples, "```", ""]
    return "\n".join(lines)


def _table(head: str, rows: list[tuple[str, str]]) -> list[str]:
    body = [f"| `{name.replace('|', chr(92) + '|')}` | {_cell(text)} |" for name, text in rows]
    return [f"| {head} | |", "|---|---|", *body, ""]


# ---------------------------------------------------------------- notices and units


def notices() -> str:
    """A section for each kind of thing that a reader may see: what she sees, its code, its meaning, what to do."""
    from dashpot.present.words import notice_guide

    lines, kind = [], ""
    for code, entry in notice_guide().items():
        if entry.kind != kind:
            kind = entry.kind
            lines += [f"## {kind}", ""]
        # The code is the anchor of links, and found as it is printed
        lines += [f"({code})=", f"### {entry.sees}", "", f"`[{code}]` {entry.meaning}", ""]
        lines += [f"*What to do:* {entry.cure}", ""]
    return "\n".join(lines)


def units() -> str:
    """What is accepted for each quantity, and every symbol with its factor."""
    from dashpot import units as of
    from dashpot.units import SYMBOLS

    lines = ["| quantity | SI | accepted, for instance |", "|---|---|---|"]
    for (quantity, angular), entry in of._QUANTITIES.items():
        name = f"{quantity} (angular)" if angular else quantity
        lines.append(f"| {name} | {entry.si} | {_cell(entry.accepted)} |")
    lines += ["", "| symbol | factor to SI | prefixes | only in |", "|---|---|---|---|"]
    alike: dict[tuple[str, ...], list[str]] = {}
    for name, meanings in SYMBOLS.items():
        for symbol in meanings:
            only = ", ".join(sorted(symbol.only)) if symbol.only else ""
            key = (str(symbol.dimension), f"{symbol.factor:.10g}", " ".join(symbol.prefixes), only)
            alike.setdefault(key, []).append(f"`{name}`")
    for (_, factor, prefixes, only), names in alike.items():
        lines.append(f"| {', '.join(names)} | {factor} | {prefixes} | {only} |")
    return "\n".join([*lines, ""])


# ---------------------------------------------------------------- the gallery


def _example(folder: Path) -> None:
    """The page of one example: its README, what its commands print, its pictures and its rig files.

    It is made again where the example or the program has changed; DASHPOT_GALLERY=keep in the environment, for those
    who write pages, keeps what is there.
    """
    readme = (folder / "README.md").read_text(encoding="utf-8")
    target = GALLERY / folder.name
    target.mkdir(parents=True, exist_ok=True)
    stamp, state = target / "made-from", _digest([folder, Path(__file__)]) + _digest_of_program()
    made = stamp.exists() and (target / "index.md").exists()
    if made and (stamp.read_text(encoding="utf-8") == state or os.environ.get("DASHPOT_GALLERY") == "keep"):
        return
    with tempfile.TemporaryDirectory() as place:
        work = Path(place) / "examples" / folder.name
        shutil.copytree(ROOT / "examples", work.parent)
        text = _with_output(readme, work)
        for picture in re.findall(r"!\[[^]]*\]\(([^)]+)\)", readme):
            shutil.copyfile(work / picture, target / Path(picture).name)
    text = re.sub(r"\]\(\.\./(\d\d_\w+)/README\.md\)", r"](../\1/index.md)", text)
    text = text.replace("](../../docs/", "](../../").replace(LONG, "")
    files = []
    for path in sorted(folder.glob("*.toml")):
        files += [f"### {path.name}", "", f"```toml\n{path.read_text(encoding='utf-8').rstrip()}\n```", ""]
    _write(target / "index.md", text.rstrip() + "\n\n## The files\n\n" + "\n".join(files))
    stamp.write_text(state, encoding="utf-8")


def _digest(places: list[Path]) -> str:
    """Of the content of files and of all files in folders."""
    total = hashlib.sha256()
    for place in places:
        for path in sorted(place.rglob("*")) if place.is_dir() else [place]:
            if path.is_file() and "__pycache__" not in path.parts:
                total.update(f"{path.relative_to(ROOT)} {path.stat().st_size}".encode() + path.read_bytes())
    return total.hexdigest()


@cache
def _digest_of_program() -> str:
    return _digest([ROOT / "src"])


def _with_output(readme: str, work: Path) -> str:
    """The text with the output of each block of commands below it, where the README does not print it itself."""
    parts = re.split(r"(^```sh\n.*?^```\n)", readme, flags=re.MULTILINE | re.DOTALL)
    for k in range(1, len(parts), 2):
        printed = _run_block(parts[k].removeprefix("```sh\n").removesuffix("```\n"), work)
        shown = re.match(r"\s*```text\n", parts[k + 1])
        if printed.strip() and shown is None:
            parts[k] += f"\n```text\n{printed.rstrip()}\n```\n"
    return "".join(parts)


def _as_on_a_terminal() -> None:
    """What every process that runs examples is started with: 80 columns, pictures into files, one thread."""
    os.environ.update(COLUMNS=WIDTH, MPLBACKEND="Agg", OPENBLAS_NUM_THREADS="1")


def _wrapped(note: re.Match[str]) -> str:
    """A note, which is one line, in as many as a page needs."""
    return textwrap.fill(note[0], int(WIDTH), subsequent_indent="      ")


def _run_block(block: str, work: Path) -> str:
    """What the commands of a block print, run one after the other in the folder of the example."""
    printed = []
    with contextlib.chdir(work):
        for line in page_commands.lines(block):
            if line.startswith("cd "):  # the README says where to stand; here that is `work`
                continue
            code, text = page_commands.run_line(line)
            if code not in (0, 3, 4):
                raise RuntimeError(f"{work.name}: {line}: {text}")
            printed.append(re.sub(r"^note: .*$", _wrapped, text, flags=re.MULTILINE))
    return "\n".join(text for text in printed if text)
