"""dashpot design: the next test, its frequencies, times and sensors, and the intervals that it will give."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from dashpot.app.files import STDOUT, InputFile, InputFileOr, OutputFile
from dashpot.app.options import (
    Positive,
    Setting,
    tell_notes,
)

if TYPE_CHECKING:
    from dashpot.data.spectrum import Spectrum
    from dashpot.design.criteria import Goal
    from dashpot.design.robust import GaussianPrior
    from dashpot.design.test_setup import Limits
    from dashpot.estimate.result import Estimate
    from dashpot.model.rigfile import Rig

_TIMES = {"": 1.0, "s": 1.0, "sec": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0}
_NUMBER = r"[+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


class Duration(click.ParamType[float]):
    """A time: 10min, 90s, 1.5h, 600."""

    name = "time"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Seconds."""
        match = re.fullmatch(rf"({_NUMBER})\s*([a-z]*)", str(value).strip())
        if match is None or match[2] not in _TIMES:
            self.fail(f"{value!r} is no time; write it as 10min, 90s or 1.5h", param, ctx)
        return float(match[1]) * _TIMES[match[2]]


class Share(click.ParamType[float]):
    """A part of something: 10% or 0.1."""

    name = "%"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The part."""
        found = share(str(value))
        if found is None:
            self.fail(f"{value!r} is no part; write it as 1% or 0.01", param, ctx)
        return found


class Band(click.ParamType[tuple[float, float]]):
    """A band of frequencies: 0.5:25."""

    name = "from:to"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, float]:
        """Lower and upper end, Hz."""
        match = re.fullmatch(rf"({_NUMBER}):({_NUMBER})", str(value).strip().removesuffix("Hz").strip())
        if match is None or not 0 < float(match[1]) < float(match[2]) < 1e12:
            self.fail(f"{value!r} is no band; write it in Hz as 0.5:25", param, ctx)
        return float(match[1]), float(match[2])


def share(text: str) -> float | None:
    """1% or 0.01 as a number; None where the text is neither."""
    match = re.fullmatch(rf"({_NUMBER})\s*(%?)", text.strip())
    if match is None or float(match[1]) <= 0:
        return None
    return float(match[1]) / (100.0 if match[2] else 1.0)


@click.command(name="design")
@click.argument("rig", type=InputFile())
@click.option("--time", "time", type=Duration(), metavar="10min", help="Time for the whole test.")
@click.option(
    "--samples", type=click.IntRange(1, 1_000_000_000), metavar="N", help="Samples of the whole test."
)
@click.option(
    "--target",
    metavar="1%|c2=2%",
    help="Relative standard deviation to reach; alone it asks for the shortest test.",
)
@click.option(
    "--band", type=Band(), help="Frequencies to choose from, Hz; about the resonances unless given."
)
@click.option(
    "--for", "wanted", default="all", show_default=True, metavar="all|worst|volume|c2,m1",
    help="What is to be precise: all on average, the worst, the volume of the confidence region, or some.",
)  # fmt: skip
@click.option("--sensors", metavar='"pick 3 of a,b,…"', help="Choose the best few sensors; the others stay.")
@click.option(
    "--against",
    type=InputFileOr(),
    metavar="DATA|LIST",
    help="Compare with a test: a file, 1,2,5 or 0.5:25:0.5 (Hz).",
)
@click.option(
    "--after",
    type=InputFile(),
    multiple=True,
    metavar="DATA|EST.json",
    help="Count in data, or an estimate, that exist.",
)
@click.option("--stroke", metavar="5mm", help="Largest displacement amplitude of the shaker.")
@click.option("--max-velocity", metavar="0.5m/s", help="Largest velocity amplitude.")
@click.option("--max-acceleration", metavar="2gn", help="Largest acceleration amplitude.")
@click.option(
    "--max-force", metavar="100N", help="Largest force amplitude; of a moved input, the rig's reaction."
)
@click.option("--amplitude", metavar="1mm", help="Of the drive, where no limit is given.")
@click.option(
    "--drive", "drives", multiple=True, metavar="u,-v", help="Inputs that move together; may be repeated."
)
@click.option(
    "--rate", type=Positive(1e9), metavar="HZ", help="Sampling rate, unless the rig file states it."
)
@click.option("--settle", type=Duration(), metavar="2s", help="Before each dwell; else from the modes.")
@click.option("--min-dwell", type=Duration(), metavar="5s", help="Shortest dwell.")
@click.option(
    "--max-frequencies", type=click.IntRange(1, 10_000), metavar="N", help="At most that many dwells."
)
@click.option("--grid", type=Positive(1e12), metavar="HZ", help="Only multiples of this frequency.")
@click.option("--doubt", type=Share(), metavar="30%", help="The values may be wrong by that much.")
@click.option(
    "--robust", type=click.Choice(["worst", "average"]),
    help="Good in the worst case of the doubt, or on average; without --doubt over an estimate's covariance.",
)  # fmt: skip
@click.option(
    "--set", "settings", type=Setting(), multiple=True, metavar="m1=3", help="A value to design for."
)
@click.option(
    "--estimate",
    "estimate_file",
    type=InputFile(),
    metavar="EST.json",
    help="Values to design for (not counted as data).",
)
@click.option(
    "--relative-noise", type=Share(), metavar="10%", help="Of all outputs, in place of the rig file's."
)
@click.option(
    "--json",
    "json_out",
    type=OutputFile(stdout=True),
    metavar="OUT",
    help="Write the answer as JSON; - is stdout.",
)
@click.option(
    "--csv", "csv_out", type=OutputFile(), metavar="OUT", help="Write the dwells for the shaker's controller."
)
@click.option(
    "--figure",
    "figure_out",
    type=OutputFile(),
    metavar="OUT.png",
    help="Draw dwells, information and intervals.",
)
@click.option(
    "--progress",
    "progress_out",
    type=OutputFile(),
    metavar="OUT.png",
    help="Draw intervals against samples of --after DATA.",
)
@click.option(
    "--frequency", type=Positive(1e12), metavar="HZ", help="Drive frequency of records that do not say it."
)
@click.option("--quiet", "-q", is_flag=True, help="Print no table and no notes.")
def command(
    rig: str,
    wanted: str,
    target: str | None,
    sensors: str | None,
    against: str | None,
    after: tuple[str, ...],
    drives: tuple[str, ...],
    settle: float | None,
    min_dwell: float | None,
    max_frequencies: int | None,
    grid: float | None,
    settings: tuple[tuple[str, float], ...],
    estimate_file: str | None,
    relative_noise: float | None,
    json_out: str | None,
    csv_out: str | None,
    figure_out: str | None,
    progress_out: str | None,
    quiet: bool,
    **more: Any,
) -> int:
    """The next test of RIG: at which frequencies to dwell, how long, with which sensors.

    The values to design for are those of the rig file (value, guess), of --set, or of an estimate.  Standard
    deviations in per cent are of the values.  The gap printed proves how good the test is (equivalence theorem).
    """
    from dashpot.check.scale import require_scale
    from dashpot.errors import UsageError
    from dashpot.io.atomic import write_text
    from dashpot.model.rigfile import read_rig

    found = read_rig(rig)
    require_scale(found.model, found.channels, rig)

    from dashpot.design.advise import Question, answer, json_of
    from dashpot.design.plan import to_csv
    from dashpot.design.test_setup import drive_units
    from dashpot.model.observation import with_relative_noise

    if more["samples"] is not None and more["time"] is not None:
        raise UsageError("both --samples and --time", cure="one of them is the budget")
    channels = found.channels
    if relative_noise is not None:
        channels = with_relative_noise(found.model, channels, relative_noise)
    data, earlier = _earlier(found, after, more, quiet)
    estimate = _load(estimate_file) if estimate_file is not None else None
    goal, aim = _goal(wanted, target)
    values = dict(settings)
    _known_names(found, values)
    if earlier is None and estimate is not None:
        values = {**_values_of(found, estimate), **values}
    if progress_out is not None and data is None:
        raise UsageError("--progress draws data as they came", cure="give them with --after DATA")
    question = Question(
        found.model, channels, goal, values, earlier, data, aim, more["samples"], more["time"], more["rate"],
        settle, 0.0 if min_dwell is None else min_dwell, max_frequencies, more["band"], grid,
        _limits(found, more), _amplitude(found, more["amplitude"]), drives,
        _doubt(found, more["robust"], more["doubt"], estimate, bool(after)),
        "worst" if more["robust"] is None else more["robust"],
        _pick(sensors), None if against is None else _against(found, against, more, quiet),
    )  # fmt: skip
    result = answer(question)
    if json_out == STDOUT:
        click.echo(json_of(result), nl=False)
    elif json_out is not None:
        write_text(json_out, json_of(result))
    if csv_out is not None and result.plan is not None:
        write_text(csv_out, to_csv(result.plan, drive_units(found.model)))
    _draw(result, figure_out, progress_out, goal, aim)
    if not quiet and json_out != STDOUT:
        from dashpot.present.tables.design import show
        from dashpot.present.tables.estimate import console

        show(result, console())
    return 0


def _draw(
    result: Any, figure_out: str | None, progress_out: str | None, goal: Goal, aim: float | None
) -> None:
    if figure_out is None and progress_out is None:
        return
    from dashpot.io.atomic import write_bytes
    from dashpot.present.figures.study import png
    from dashpot.present.tables.design import figure, progress_figure

    if figure_out is not None and result.plan is not None:
        write_bytes(figure_out, png(figure(result)))
    if progress_out is not None:
        targets = dict(getattr(goal, "targets", {}))
        if not targets and aim is not None:
            targets = dict.fromkeys((u.name for u in result.bench.model.unknowns), aim)
        drawn = progress_figure(result, targets)
        if drawn is not None:
            write_bytes(progress_out, png(drawn))


def _known_names(rig: Rig, values: dict[str, float]) -> None:
    from dashpot.errors import UsageError

    own = {unknown.name: unknown for unknown in rig.model.unknowns}
    for name, value in values.items():
        if name not in own:
            raise UsageError(
                f"--set {name}: no unknown of this rig", rig.path, f"its unknowns are {', '.join(own)}"
            )
        if value < 0 and own[name].unit == "kg":
            raise UsageError(f"--set {name}: a mass of {value:g} kg", rig.path, "give a positive mass")


def _load(path: str) -> Estimate:
    from dashpot.estimate.result import Estimate

    return Estimate.load(path)


def _values_of(rig: Rig, estimate: Estimate) -> dict[str, float]:
    own = [unknown.name for unknown in rig.model.unknowns]
    return {n: float(v) for n, v in zip(estimate.names, estimate.values, strict=True) if n in own}


def _earlier(
    rig: Rig, after: tuple[str, ...], more: dict[str, Any], quiet: bool
) -> tuple[Spectrum | None, Estimate | None]:
    """Existing data, or one existing estimate."""
    from dashpot.errors import UsageError

    estimates = [path for path in after if path.lower().endswith(".json")]
    if not after:
        return None, None
    if estimates:
        if len(after) > 1:
            raise UsageError("an estimate and other data", cure="give either one estimate, or all the data")
        return None, _load(estimates[0])
    return _read(rig, after, more, quiet), None


def _read(rig: Rig, paths: tuple[str, ...], more: dict[str, Any], quiet: bool) -> Spectrum:
    from dashpot.data.readers import read

    reading = read(paths, rig.channels, frequency_hz=more["frequency"])
    tell_notes(reading.notes, quiet)
    spectrum = reading.spectrum()
    tell_notes(spectrum.notes, quiet)
    return spectrum


def _goal(wanted: str, target: str | None) -> tuple[Goal, float | None]:
    """What --for and --target ask for, and the figure to reach."""
    from dashpot.design.criteria import MeanError, Targets, Volume, WorstError
    from dashpot.errors import UsageError

    aim = None
    if target is not None and "=" in target:
        if wanted != "all":
            raise UsageError("--for with a target by names", cure="the targets say what is to be precise")
        targets = {}
        for part in target.split(","):
            name, _, text = part.partition("=")
            number = share(text)
            if number is None or not name.strip():
                raise UsageError(f"{part.strip()!r} is no target", cure="write it as c2=2%,m1=1%")
            targets[name.strip()] = number
        return Targets(targets), 1.0
    if target is not None:
        aim = share(target)
        if aim is None:
            raise UsageError(f"{target!r} is no target", cure="write it as 1% or c2=2%")
    if wanted == "all":
        return MeanError(), aim
    if wanted == "worst":
        return WorstError(), aim
    if wanted == "volume":
        return Volume(), aim
    names = tuple(name.strip() for name in wanted.split(",") if name.strip())
    if not names:
        raise UsageError("--for names nothing", cure="write all, worst, volume, or names such as c2,m1")
    return MeanError(names), aim


def _quantity(rig: Rig, text: str, quantity: str) -> float:
    """5mm, or 0.005, in SI units."""
    from dashpot.errors import UsageError
    from dashpot.units import scale

    match = re.fullmatch(rf"({_NUMBER})\s*(\D.*)?", text.strip())
    if match is None or float(match[1]) <= 0:
        raise UsageError(
            f"{text!r} is no {quantity}", cure="write a positive number with its unit, such as 5mm or 100N"
        )
    points = {*rig.model.displacement_inputs, *(p for one in rig.model.inputs for p in one.at)}
    angular = bool(points) and points <= set(rig.model.angles)
    return float(match[1]) * (1.0 if match[2] is None else scale(match[2].strip(), quantity, angular))


def _limits(rig: Rig, more: dict[str, Any]) -> Limits:
    from dashpot.design.test_setup import Limits

    def limit(option: str, quantity: str) -> float | None:
        return None if more[option] is None else _quantity(rig, more[option], quantity)

    return Limits(
        limit("stroke", "displacement"), limit("max_velocity", "velocity"),
        limit("max_acceleration", "acceleration"), limit("max_force", "force"),
    )  # fmt: skip


def _amplitude(rig: Rig, text: str | None) -> float | None:
    if text is None:
        return None
    return _quantity(rig, text, "displacement" if rig.model.displacement_inputs else "force")


def _doubt(
    rig: Rig,
    robust: str | None,
    doubt: float | None,
    estimate: Estimate | None,
    after: bool,
) -> float | GaussianPrior | Literal["estimate"] | None:
    """A part of every value, or the covariance of --estimate, or of what --after tells."""
    from dashpot.design.robust import gaussian_prior_of
    from dashpot.errors import UsageError

    if robust is None or doubt is not None:
        return doubt
    if estimate is not None:
        return gaussian_prior_of(rig.model, estimate)
    if not after:
        raise UsageError(
            "--robust without a doubt",
            cure="give --doubt 30%, or --estimate or --after, whose covariance is the doubt",
        )
    return "estimate"


def _pick(text: str | None) -> tuple[int, tuple[str, ...]] | None:
    from dashpot.errors import UsageError

    if text is None:
        return None
    match = re.fullmatch(r"\s*(?:pick\s+)?(\d+)(?:\s+of\s+(.+))?\s*", text)
    if match is None:
        raise UsageError(f"{text!r} chooses no sensors", cure='write it as --sensors "pick 3 of a,b,c,d"')
    names = () if match[2] is None else tuple(name.strip() for name in match[2].split(",") if name.strip())
    return int(match[1]), names


def _against(rig: Rig, text: str, more: dict[str, Any], quiet: bool) -> tuple[float, ...] | Spectrum:
    """A list of frequencies, or the lines of a file."""
    from dashpot.design.plan import frequencies_of

    if Path(text).exists():
        return _read(rig, (text,), more, quiet)
    return frequencies_of(text)
