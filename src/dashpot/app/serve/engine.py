"""The engine of the page: calls in JSON, answers in JSON, the same as those of Python and the command line.

`carry_out` is the whole protocol and knows of no server: a page without one calls it in its own process.  As a program
(`python -m dashpot.app.serve.engine`) it takes a call a line from stdin and writes a line for every event to stdout:

    {"call": "identify", "folder": "…", "rig": "rig.toml", "data": ["run1.csv"]}
    {"progress": ["identify", 3, 16]}
    {"result": {…}}                      as far as there is one: the last one is whole
    {"done": true}                       or {"failed": {"problems": […], "code": 3}}

Paths are those in `folder`, the working directory; no file outside `folder` and the folders of `reads` is read.
Files that a rig names, such as matrices of [blocks], are also found in the folder `beside`, from which it came.
"""

from __future__ import annotations

import importlib
import io
import json
import os
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dashpot.errors import (
    ConvergenceError,
    DashpotError,
    DataError,
    IdentifiabilityError,
    Problem,
    UsageError,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from dashpot.app.data_files import RecordOptions
    from dashpot.channel import Channel
    from dashpot.estimate.result import Estimate
    from dashpot.model.rigfile import Rig
    from dashpot.present.document import TableColumn

Call = Mapping[str, Any]
Tell = Callable[[dict[str, Any]], None]

KEPT = "result.json"  # a session's own copy of what was told
SCRATCH = ".scratch"  # folder for files in between, in that of a call
PRIVATE = ".dashpot"  # folder of the sessions, in the one that is served


def carry_out(call: Call, tell: Tell) -> None:
    """Carry out one call; `tell` is called with every event, the last of which is "done" or "failed"."""
    from dashpot.app.cli import account
    from dashpot.app.workers import heard
    from dashpot.io.json_document import to_json
    from dashpot.io.ledger import opened

    def told(event: dict[str, Any]) -> None:
        tell(json.loads(to_json(event)))

    listening = heard.set(lambda what, done, total: told({"progress": [what, done, total]}))
    before, usual = os.getcwd(), tempfile.tempdir
    try:
        work = CALLS.get(str(call.get("call")))
        if work is None:
            raise UsageError(f"there is no call {call.get('call')!r}", cure=f"take {', '.join(CALLS)}")
        os.chdir(call["folder"])
        # Files in between, too, are in the folder: what a call that is ended leaves goes with the session.
        tempfile.tempdir = os.path.join(call["folder"], SCRATCH)
        os.makedirs(tempfile.tempdir, exist_ok=True)
        with opened(_readable(call["folder"], call.get("reads", ())), call.get("beside")):
            work(call, told)
    except Exception as error:
        lines, code = account(error)
        import re

        found = error.problems if isinstance(error, DashpotError) else [Problem(line) for line in lines]
        said = []
        for problem in found[:20]:
            place = re.match(r"(.*\.toml):(\d+)(?::|$)", problem.where or "")
            said.append({"text": str(problem), "line": None if place is None else int(place[2])})
        told({"failed": {"problems": said, "code": code}})
    else:
        told({"done": True})
    finally:
        heard.reset(listening)
        os.chdir(before)
        tempfile.tempdir = usual


def _readable(folder: str, others: Sequence[str]) -> Callable[[str], bool]:
    """Whether a file is in the folder of the call, or in another that it names but not among other sessions there."""
    own, rest = os.path.realpath(folder), [os.path.realpath(each) for each in others]

    def within(place: str, root: str) -> bool:
        return os.path.commonpath((root, place)) == root

    def readable(place: str) -> bool:
        shared = any(within(place, root) and not within(place, os.path.join(root, PRIVATE)) for root in rest)
        return within(place, own) or shared

    return readable


def _command(*arguments: str) -> None:
    """Run a command of the command line.  Raises UsageError with what it says where it fails."""
    from dashpot.app.cli import run

    said = io.StringIO()
    with redirect_stdout(io.StringIO()), redirect_stderr(said):
        code = run(arguments)
    if code:
        lines = [line.removeprefix("dashpot: ") for line in said.getvalue().splitlines() if line.strip()]
        raise UsageError([Problem(line) for line in lines if not line.startswith("note: ")])


# Rigs: read, drawn, edited.


def _open(call: Call, tell: Tell) -> None:
    """A rig's text: its parts, its channels, and its drawing."""
    from dashpot.errors import ModelError
    from dashpot.io.toml_document import Lines
    from dashpot.model.rigfile import parse_rig

    rig = parse_rig(call["text"], call["rig"])
    model, lines = rig.model, Lines(call["text"])
    sections = {element.name: f"{element.kind.section}" for element in model.elements if element.only is None}
    parts = [
        {
            "name": element.name,
            "section": sections[element.name],
            "joins": list(element.along),
            "value": element.value,
            "sd": element.sd,
            "guess": element.guess,
            "unit": model.unit(element),
            "line": lines.of((sections[element.name], element.name)),
        }
        for element in model.elements
        if element.name in sections and not element.free and element.block is None
    ]
    channels = [
        {**_shown_channel(channel), "line": lines.of(("channels", channel.name))} for channel in rig.channels
    ]
    try:
        drawing = _drawn(rig)
    except (UsageError, ModelError, DashpotError) as error:
        drawing = {"svg": None, "why": str(error)}
    points = [*model.coordinates, *model.displacement_inputs, "ground"]
    tell(
        {
            "result": {
                "name": model.name,
                "parts": parts,
                "points": points,
                "channels": channels,
                "drawing": drawing,
                "coordinates": list(model.coordinates),
                "inputs": [source.name for source in model.inputs],
            }
        }
    )


def _drawn(rig: Rig, estimate: Estimate | None = None, mode: int | None = None) -> dict[str, Any]:
    from dashpot.api import draw

    return {"svg": draw(rig, estimate, mode=mode).svg()}


def _shown_channel(channel: Channel) -> dict[str, Any]:
    of = " + ".join(point if factor == 1 else f"{factor:g} {point}" for point, factor in channel.of.items())
    return {
        "name": channel.name,
        "column": channel.column,
        "of": of.replace("+ -1 ", "− ").replace("+ -", "− "),
        "quantity": channel.quantity.value,
        "unit": channel.unit or "",
    }


def _edit(call: Call, tell: Tell) -> None:
    """A rig's text with one change: {"section", "name", "set"|"add"|"rename"|"remove"}; "add" may hold a new point."""
    import copy
    import tomllib

    from dashpot.model.rigfile import parse_rig
    from dashpot.model.rigfile.writer import edited_table

    text, change = call["text"], call["change"]
    section, name = str(change["section"]), str(change["name"]).strip()
    before = tomllib.loads(text)
    after = copy.deepcopy(before)
    entries = after.setdefault(section, {})
    if not name:
        raise UsageError("the name is empty", cure="write one, such as k1")
    new = str(change.get("rename") or name).strip()
    if "add" in change:
        if any(name in table for table in before.values() if isinstance(table, dict)):
            raise UsageError(f"{name} is there already", cure="choose another name")
        entries[name] = {
            key: _typed(value) for key, value in change["add"].items() if value not in (None, "")
        }
        points = after.setdefault("coordinates", [])
        if section == "masses" and change["add"].get("at") not in points:
            points.append(change["add"]["at"])
    elif name not in entries:
        raise UsageError(f"{name} is not in [{section}]", cure="choose another one")
    elif change.get("remove"):
        del entries[name]
        if not entries:
            del after[section]
    else:
        for key, value in change.get("set", {}).items():
            entries[name] = entries[name] if isinstance(entries[name], dict) else {}
            if value in (None, ""):
                entries[name].pop(key, None)
            else:
                entries[name][key] = _typed(value)
    changed = edited_table(text, before, after)
    if new != name:
        import re

        from dashpot.io.toml_document import Lines, toml_key
        from dashpot.io.words import quoted

        line = Lines(changed).of((section, name))
        assert line is not None
        lines = changed.splitlines(keepends=True)
        key = re.compile(rf"(?<![\w-])(?:{re.escape(name)}|{re.escape(quoted(name))})(?=\s*[=.\]])")
        lines[line - 1] = key.sub(lambda _: toml_key(new), lines[line - 1], count=1)
        named = rf"\b(same_as|same_gain_as|of)(\s*=\s*){re.escape(quoted(name))}"
        changed = re.sub(named, lambda match: f"{match[1]}{match[2]}{quoted(new)}", "".join(lines))
    parse_rig(changed, call["rig"])
    tell({"result": {"text": changed}})


def _typed(value: Any) -> Any:
    """What a form holds as TOML holds it: a number where it is one."""
    if isinstance(value, str):
        plain = value.strip().replace("−", "-")
        for read in (int, float):
            with suppress(ValueError):
                return read(plain)
        return plain
    return value


# Data: what is in them, and how they match the rig.


def _data(call: Call) -> list[str]:
    """The data files of a call, without those that a manifest among them names."""
    from dashpot.data.readers.manifest import files_named, is_manifest

    names = [str(name) for name in call.get("data", ())]
    named = {os.path.realpath(path) for name in names if is_manifest(name) for path in files_named(name)}
    return [name for name in names if is_manifest(name) or os.path.realpath(name) not in named]


def _inspect(call: Call, tell: Tell) -> None:
    """What is in data files: columns and units, how they match the channels of a rig, plots with what is masked."""
    from dashpot.data.inspection import channels_in, inspect_named
    from dashpot.present.data import column_remarks, part_in_words

    files, columns = [], dict[str, str | None]()
    data, problems = list[str](), list[Problem]()
    for name in _data(call):
        try:
            inspections = inspect_named(name)
        except DashpotError as error:  # one file that cannot be read hides no other
            problems += error.problems
            continue
        data.append(name)
        for found in inspections:
            parts = []
            for part in found.parts:
                columns |= {
                    channel.name: channel.unit for channel in part.channels if channel.name not in columns
                }
                rows = [
                    {
                        "name": c.name,
                        "unit": c.unit or "",
                        "rms": c.rms,
                        "least": c.least,
                        "greatest": c.greatest,
                        "remarks": column_remarks(c),
                    }
                    for c in part.columns
                ]
                notes = [note.text for note in part.notes] + [str(error) for error in part.damaged[:5]]
                parts.append({"text": part_in_words(part, found.source), "columns": rows, "notes": notes})
            files.append({"name": os.path.basename(found.source), "format": found.format, "parts": parts})
    if problems and not data:
        raise DataError(problems)
    result: dict[str, Any] = {"files": files, **{name: [] for name in ("channels", "plots", "notes")}}
    result["problems"] = [str(problem) for problem in problems[:20]]
    from dashpot.errors import ModelError
    from dashpot.model.rigfile import parse_rig

    try:
        rig = parse_rig(call["text"], call["rig"]) if call.get("text") else None
    except ModelError:
        rig = None
    if rig is not None:
        for channel in rig.channels:
            there = channel.column in columns
            unit = columns.get(channel.column)
            result["channels"].append({**_shown_channel(channel), "found": there, "file_unit": unit or ""})
        mapped = {channel.column for channel in rig.channels}
        result["unused"] = [name for name in columns if name not in mapped]
    tell({"result": result})
    try:
        result["plots"], result["notes"] = _plots(rig or list(channels_in(data).values()), data)
    except DashpotError as error:
        result["problems"] = [str(problem) for problem in [*problems, *error.problems][:20]]
    tell({"result": result})


def _plots(rig: Rig | Sequence[Channel], data: Sequence[str]) -> tuple[list[dict[str, Any]], list[str]]:
    """A picture for each channel, as read; samples that are not used as measured are marked in it."""
    from dashpot.api import read
    from dashpot.data.conditioning.unmeasured import marked, marked_whole
    from dashpot.present.figures.traces import lines_svg, trace_svg

    reading = read([*data], rig)
    notes = [note.text for note in reading.notes]
    records = reading.records
    if not records and reading.amplitudes is not None:
        spectrum = reading.amplitudes
        pictures = [
            {
                "name": channel.name,
                "svg": lines_svg(
                    channel.name,
                    channel.unit,
                    spectrum.frequency_hz,
                    spectrum.amplitudes[:, i] / channel.scale,
                ),
            }
            for i, channel in enumerate(spectrum.channels)
        ]
        return pictures, notes
    if reading.continuous:
        whole = [marked_whole(record) for record in records]
        shown = [part for parts, _ in whole for part in parts]
        notes += [note.text for _, more in whole for note in more]
    else:
        shown, more = marked(records)
        notes += [note.text for note in more]
    channels = {channel.name: channel for record in shown for channel in record.channels}
    pictures = []
    for name, channel in channels.items():
        stretches = []
        for record in shown:
            for i, each in enumerate(record.channels):
                if each.name == name and record.values.ndim == 2:
                    status = None if record.status is None else record.status[:, i] != 0
                    stretches.append((record.time, record.values[:, i] / channel.scale, status))
        pictures.append({"name": name, "svg": trace_svg(name, channel.unit, stretches)})
    return pictures, list(dict.fromkeys(notes))


def _start(call: Call, tell: Tell) -> None:
    """A rig file for data that nobody has described; its questions with the answers that count so far."""
    from dataclasses import replace

    from dashpot.app.commands.new import DRIVES
    from dashpot.check.first_rig import first_rig, seen_data
    from dashpot.data.inspection import inspect_named
    from dashpot.io.toml_document import PLACEHOLDER
    from dashpot.model.rigfile.writer import starter_text
    from dashpot.quantities import amount

    answers: Mapping[str, str] = {
        key: str(value).strip() for key, value in call.get("answers", {}).items() if value
    }
    seen = seen_data([found for name in _data(call) for found in inspect_named(name)])
    questions: list[dict[str, Any]] = []
    columns = []
    for column in seen.columns:
        if column.unit is None:
            key = f"unit of {column.name}"
            usual = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s²", "force": "N"}
            said = answers.get(key, usual.get(column.quantity or "", ""))
            questions.append({"key": key, "ask": f"Unit of {column.name}", "answer": said})
            column = column.in_unit(said) if said else column
        columns.append(column)
    seen = replace(seen, columns=tuple(columns))
    drive: Any = answers.get("drive", seen.drive)
    choices = {
        "base": "The base moves",
        "force": "A force acts",
        "release": "The masses are let go",
        "stand": "An element stands on a test stand",
    }
    assert {*DRIVES} <= {*choices}
    questions.insert(0, {"key": "drive", "ask": "What drives the rig", "answer": drive, "choices": choices})
    moving = [column.name for column in columns if column.quantity != "force"]
    base = None
    if drive == "base" and not any(column.of_base for column in columns):
        base = answers.get("base")
        questions.append(
            {
                "key": "base",
                "ask": "Column of the base",
                "answer": base or "",
                "choices": {name: name for name in moving},
            }
        )
    known = answers.get("mass")
    mass = None
    if known:
        mass = amount(known).si("mass") if not known.replace(".", "", 1).isdigit() else float(known)
    chain = first_rig(seen, call.get("title") or "My rig", drive, mass, answers.get("at"), base)
    if chain.at == PLACEHOLDER or answers.get("at"):
        places = {f"x{i + 1}": f"x{i + 1}" for i in range(chain.masses)}
        questions.append(
            {
                "key": "at",
                "ask": "Mass that the force acts on",
                "answer": answers.get("at", ""),
                "choices": places,
            }
        )
    if chain.lacks_scale or known:
        questions.append({"key": "mass", "ask": "Mass of x1 in kg, if weighed", "answer": known or ""})
    tell({"result": {"text": starter_text(chain), "questions": questions}})


# Identification, the next test, other programs.


def _identify(call: Call, tell: Tell) -> None:
    """An estimate as the command gives it, then its pictures and its report, in the folder `out`.

    `options`: method, band and within as on the command line; `rest`: records at rest among the files.
    """
    from dataclasses import replace

    from dashpot.app import options as opt
    from dashpot.app.commands.identify import Identified, identified, of_modes, require_answer
    from dashpot.app.workers import progress
    from dashpot.data.readers.modes import holds_modes
    from dashpot.io.atomic import write_text
    from dashpot.model.rigfile import read_rig
    from dashpot.present.identification import failure_report
    from dashpot.present.page import provenance_of

    data, out, options = _data(call), Path(call["out"]), call.get("options", {})
    rig = read_rig(call["rig"])
    if not data:
        raise UsageError("there are no data", cure="drop data files on the page")
    words = [
        *(f"--{name} {value}" for name, value in options.items() if value),
        *(f"--noise-record {name}" for name in call.get("rest", ())),
    ]
    if options.get("within"):
        rig = replace(rig, within=opt.PART.convert(options["within"], None, None))
    chosen = str(options.get("method") or "auto")
    records = _records(call)
    command = " ".join(["dashpot identify", call["rig"], *data, *words])
    try:
        if len(data) == 1 and holds_modes(data[0]):
            shares = opt.MODAL_SD.convert("1%,20%,5%", None, None)
            found = Identified(of_modes(rig, data[0], shares, 0, True))
        else:
            require_answer(rig, chosen, False, False)
            found = identified(rig, data, records, chosen, False, 0, 0.0, False, True)
    except (IdentifiabilityError, ConvergenceError) as error:
        write_text(
            out / "report.html", failure_report(rig.model, rig.channels, error, provenance_of(command))
        )
        empty: dict[str, Any] = {"heads": [], "rows": [], "right": []}
        why = "the channels and data do not determine the unknowns"
        if isinstance(error, ConvergenceError):
            why = "the iteration did not converge"
        nothing = {
            "estimate": None,
            "verdict": "bad",
            "headline": f"No answer: {why}.",
            "statements": [str(problem) for problem in error.problems],
            "causes": _causes(rig, error.causes),
            "parameters": empty,
            "modes": empty,
            "drawing": None,
            **{name: [] for name in ("remarks", "warnings", "notes", "shapes")},
        }
        tell({"result": {**nothing, "files": _files(out)}})
        return
    estimate = found.estimate
    write_text(out / "estimate.json", estimate.to_json())
    result = _words(rig, estimate)
    findings = () if estimate.assessment is None else estimate.assessment.findings
    result["causes"] = _causes(rig, findings)
    tell({"result": result})
    with progress("drawing"):
        result["drawing"] = _tried(partial(_drawn, rig, estimate))
        _tried(lambda: found.draw(str(out / "fit.svg"), rig))
        shapes = [
            _tried(partial(_drawn, rig, estimate, mode))
            for mode in range(1, 1 + min(4, len(result["modes"]["rows"])))
        ]
        result["shapes"] = [shape["svg"] for shape in shapes if shape]
        result["files"] = _files(out)
    tell({"result": result})
    with progress("report"):
        write_text(out / "report.html", found.report(rig, 0.95, provenance_of(command)))
    result["files"] = _files(out)
    tell({"result": result})


def _records(call: Call) -> RecordOptions:
    """How the records of a call are read: its band, and its records at rest."""
    from dataclasses import replace

    from dashpot.app import options as opt
    from dashpot.app.data_files import RecordOptions

    stated = call.get("options", {}).get("band")
    band = opt.BAND.convert(stated, None, None) if stated else None
    return replace(RecordOptions.usual(), record_band=band, noise_record=tuple(call.get("rest", ())))


def _files(folder: Path) -> list[str]:
    """What may be downloaded of a result, but for what sessions keep there themselves."""
    return sorted(
        path.name for path in folder.iterdir() if path.name != KEPT and not path.name.startswith(".")
    )


def _tried(work: Callable[[], Any]) -> Any:
    """What is drawn; None if it cannot be, which costs a picture and no answer."""
    try:
        return work()
    except DashpotError:
        return None


def _words(rig: Rig, estimate: Estimate) -> dict[str, Any]:
    """The JSON of an estimate, and what the command and its report say of it."""
    from dashpot.check.evidence import doubtful
    from dashpot.present.estimate import (
        convergence_in_words,
        diagnosis_in_words,
        fit_paragraphs,
        has_modes,
        headline,
        mode_columns,
        page_verdict,
        parameter_columns,
        reasons_in_words,
        remarks,
        residuals_in_words,
        warnings_in_words,
    )
    from dashpot.present.words import sentence

    content = json.loads(estimate.to_json())
    findings = () if estimate.assessment is None else estimate.assessment.findings
    causes = set(diagnosis_in_words(findings))
    modes = mode_columns(estimate.modes) if has_modes(estimate) else []
    statements = [each.text for each in fit_paragraphs(estimate)]
    if estimate.assessment is not None:  # the verdict itself is the headline
        reasons = reasons_in_words(estimate, estimate.assessment)
        statements[:1] = [*reasons, residuals_in_words(estimate.fit)]
    return {
        "estimate": content,
        "verdict": page_verdict(estimate),
        "headline": headline(estimate, doubtful(estimate)),
        "statements": [text for text in statements if text and text not in causes],
        "remarks": [convergence_in_words(estimate), *remarks(estimate)],
        "parameters": _table(parameter_columns(estimate)),
        "modes": _table(modes),
        "warnings": [*warnings_in_words(estimate, untried=(), coded=True)],
        "notes": [f"{sentence(note.text)} [{note.code}]" for note in estimate.notes],
        "drawing": None,
        "shapes": [],
        "files": [],
    }


def _causes(rig: Rig, findings: Sequence[object]) -> list[dict[str, Any]]:
    """What may be the matter, with the text of the rig file as each remedy would have it, where one does."""
    from dashpot.app.commands.identify import corrected, with_a_line
    from dashpot.estimate.assessment import Finding
    from dashpot.present.estimate import percent_of_odds

    causes = []
    for finding in findings:
        if isinstance(finding, Finding):
            after = {"text_after": corrected(rig, finding)} if with_a_line([finding]) else {}
            if finding.odds is not None:
                where = "beside the first, " if finding.beside else ""
                after["chance"] = f"{where}{percent_of_odds(finding.odds)}"
            shown = ("text", "change", "kind", "odds", "explains")
            causes.append(
                {**{name: getattr(finding, name) for name in shown}, "of": list(finding.of), **after}
            )
    return causes


def _table(columns: Sequence[TableColumn]) -> dict[str, Any]:
    """A table's heads and rows, and which of its columns stand flush right."""
    return {
        "heads": [" ".join(column.title.split()) for column in columns],
        "rows": [list(cells) for cells in zip(*(column.cells for column in columns), strict=True)],
        "right": [column.justify == "right" for column in columns],
    }


def _design(call: Call, tell: Tell) -> None:
    """The next test after the data at hand, within what the shaker can do: options as of `dashpot design`.

    `rest`: records at rest among the files, as `identify` takes them.
    """
    out = Path(call["out"])
    tell({"result": {"plan": _planned(call, out, call.get("data", ())), "files": _files(out)}})


def _planned(call: Call, out: Path, data: Sequence[str]) -> dict[str, Any]:
    """The plan of `dashpot design` after data, and its files in a folder."""
    from dashpot.io.ledger import noted

    options = [
        f"--{name}={value}" for name, value in call.get("options", {}).items() if value not in (None, "")
    ]
    after = [f"--after={name}" for name in data]
    after += [f"--noise-record={name}" for name in call.get("rest", ())]
    files = [
        "--json",
        str(out / "plan.json"),
        "--csv",
        str(out / "plan.csv"),
        "--figure",
        str(out / "plan.svg"),
    ]
    _command("design", call["rig"], *after, *options, *files)
    plan: dict[str, Any] = json.loads(Path(noted(out / "plan.json")).read_text(encoding="utf-8"))
    return plan


def _watch(call: Call, tell: Tell) -> None:
    """A test that still runs, until the call is ended: of `source`, a file or folder, with a `target` such as 1%.

    `options` are those of the next dwell; `band` and `rest` are those of the data, as `identify` takes them.
    """
    from dashpot.app.serve.live import watch
    from dashpot.io.ledger import opened
    from dashpot.model.rigfile import read_rig
    from dashpot.quantities import fraction

    rig, out, source = read_rig(call["rig"]), Path(call["out"]), Path(call["source"])
    target = str(call.get("target") or "2%")
    band = call.get("band")
    options = {**call.get("options", {}), "target": target, "record-band": band}

    def plan(files: Sequence[str]) -> Mapping[str, Any]:
        with opened():  # written anew every time
            return _planned({**call, "options": options}, out, files)

    if not source.exists():
        raise UsageError("there is no such file or folder", str(source), "choose one that is there")
    watch(
        rig,
        source,
        out / "live",
        _records({"options": {"band": band}, "rest": call.get("rest", ())}),
        fraction(target),
        plan,
        lambda told: tell({"result": {**told, "files": []}}),
    )


def _export(call: Call, tell: Tell) -> None:
    """A file for another program; the end of its name says which."""
    target = Path(call["out"]) / call["name"]
    _command("export", call["estimate"], "--rig", call["rig"], "-o", str(target))
    tell({"result": {"file": call["name"]}})


CALLS: Mapping[str, Callable[[Call, Tell], None]] = {
    "open": _open,
    "edit": _edit,
    "inspect": _inspect,
    "start": _start,
    "identify": _identify,
    "design": _design,
    "export": _export,
    "watch": _watch,
}


# As a program.


@contextmanager
def _own_stdout() -> Iterator[io.TextIOWrapper]:
    """Standard output for events alone: what libraries print goes nowhere."""
    kept = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    with os.fdopen(kept, "w", encoding="utf-8") as stream:
        yield stream


def serve_calls() -> None:
    """Answer calls from stdin, one after the other; end with the process that makes them, whatever is under way."""
    import threading
    from queue import SimpleQueue

    from dashpot.app.process import one_thread

    one_thread()
    calls: SimpleQueue[str] = SimpleQueue()

    def listen() -> None:
        for line in sys.stdin:
            calls.put(line)
        os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    for module in ("dashpot.api", "dashpot.present.identification"):  # the first call finds them loaded
        importlib.import_module(module)
    with _own_stdout() as stream:

        def tell(event: dict[str, Any]) -> None:
            stream.write(json.dumps(event, ensure_ascii=False) + "\n")
            stream.flush()

        while True:
            carry_out(json.loads(calls.get()), tell)


if __name__ == "__main__":
    serve_calls()
