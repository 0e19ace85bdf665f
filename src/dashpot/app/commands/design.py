"""dashpot design: the next test, its frequencies, times and sensors, and the intervals that it will give."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import click

from dashpot.app.options import (
    AMOUNT,
    AMPLITUDE,
    BAND,
    FREQUENCY,
    INPUT_FILE,
    INPUT_FILE_OR,
    SENSORS,
    SETTLING,
    SHARE,
    STDOUT,
    TARGET,
    TIME,
    Count,
    conditioning_options,
    dashpot_command,
    dask_option,
    figure_option,
    file_option,
    json_option,
    names,
    option,
    quiet_option,
    relative_noise_option,
    rig_argument,
    set_option,
    transient_options,
)
from dashpot.app.report_files import report_option

if TYPE_CHECKING:
    from dashpot.channel import Channel
    from dashpot.data.spectrum import Spectrum
    from dashpot.design.advise import Answer, Question
    from dashpot.design.allocation import Criterion
    from dashpot.design.robust import GaussianPrior
    from dashpot.design.test_setup import ShakerLimits
    from dashpot.estimate.result import Estimate
    from dashpot.model.rigfile import Rig
    from dashpot.quantities import Amount

BUDGET, AIM = "Size of the test", "Aim of the test"
BASIS = "What is known"
TEST, SHAKER, ROBUST = "The test", "The shaker", "Robustness"


@dashpot_command(
    "design",
    "dashpot design rig.toml --samples 1400 --set m1=3,c1=30",
    "dashpot design rig.toml --after data.csv --target 1% --rate 500 --stroke 5mm --json plan.json",
    'dashpot design rig.toml --time 10min --rate 500 --sensors "pick 2 of x1,x2,acc3" --against 2:10/5',
)
@rig_argument
@option("--samples", type=Count(1), metavar="N", group=BUDGET, help="Samples of the whole test.")
@option(
    "--time", type=TIME, metavar="10min", group=BUDGET, help="Duration of the whole test, settling included."
)
@option(
    "--target",
    type=TARGET,
    metavar="1%|c2=2%,…",
    group=BUDGET,
    help="Relative standard deviation to reach; without --samples and --time the shortest test that reaches it is "
    "designed.",
)
@option(
    "--for", "wanted", default="all", show_default=True, metavar="all|worst|volume|NAME,…", group=AIM,
    help="What should be precise: all unknowns on average, the worst one, the volume of the confidence region, or the "
    "unknowns named.",
)  # fmt: skip
@option(
    "--sensors",
    type=SENSORS,
    metavar='"pick 3 of a,b,…"',
    group=AIM,
    help="Choose the best few of these channels; channels that are not listed stay.",
)
@option(
    "--against",
    type=INPUT_FILE_OR,
    metavar="FILE|LIST|RANGE",
    group=AIM,
    help="Compare with another test: a data file, or frequencies in Hz as 1,2,5, 1:10:0.5 or 1:10/25.",
)
@set_option(BASIS, "settings", "Values to design for")
@option(
    "--estimate", "estimate_file", type=INPUT_FILE, metavar="FILE.json", group=BASIS,
    help="Take the values to design for from an estimate, without counting it as data.",
)  # fmt: skip
@option(
    "--after", type=INPUT_FILE, multiple=True, metavar="DATA|FILE.json", group=BASIS,
    help="Existing data or estimate to build on.  May be repeated.",
)  # fmt: skip
@relative_noise_option(BASIS)
@option(
    "--band",
    type=BAND,
    metavar="LOWER:UPPER",
    group=TEST,
    help="Frequencies to choose from, Hz.  [default: around the resonances]",
)
@option("--grid", type=FREQUENCY, metavar="HZ", group=TEST, help="Use only multiples of this frequency.")
@option("--max-frequencies", type=Count(1, 10_000), metavar="N", group=TEST, help="Largest number of dwells.")
@option("--min-dwell", type=TIME, metavar="5s", group=TEST, help="Shortest dwell.")
@option(
    "--settling-time", type=SETTLING, default="auto", show_default=True, metavar="auto|none|2s", group=TEST,
    help="Wait before each dwell; auto takes three decades of the decay of the slowest mode.",
)  # fmt: skip
@option(
    "--rate", type=FREQUENCY, metavar="HZ", group=TEST, help="Sampling rate.  [default: that of the rig file]"
)
@option("--stroke", type=AMOUNT, metavar="5mm", group=SHAKER, help="Largest displacement amplitude.")
@option("--max-velocity", type=AMOUNT, metavar="0.5m/s", group=SHAKER, help="Largest velocity amplitude.")
@option(
    "--max-acceleration", type=AMOUNT, metavar="2gn", group=SHAKER, help="Largest acceleration amplitude."
)
@option(
    "--max-force",
    type=AMOUNT,
    metavar="100N",
    group=SHAKER,
    help="Largest force amplitude; for a moved base, of the force that moves it.",
)
@option(
    "--amplitude",
    type=AMPLITUDE,
    metavar="[INPUT=]VALUE",
    group=SHAKER,
    help="Amplitude of the drive, where no limit is given.",
)
@option(
    "--drive", "drives", multiple=True, metavar="u,-v", group=SHAKER,
    help="Inputs that move together, in phase or (with -) in antiphase.  May be repeated.",
)  # fmt: skip
@option(
    "--doubt", type=SHARE, metavar="30%", group=ROBUST, help="How far the values to design for may be wrong."
)
@option(
    "--robust",
    type=click.Choice(["worst", "average"]),
    group=ROBUST,
    help="Design for the worst case of the doubt, or for the average.  Without --doubt, the covariance of --estimate "
    "or --after is the doubt.",
)
@json_option("the plan")
@file_option("--csv", "FILE.csv", "Write the dwells for the shaker's controller.")
@figure_option("Draw dwells, information and the expected intervals.")
@figure_option("Draw how the intervals shrank as the data of --after came in.", "--progress")
@report_option
@conditioning_options
@transient_options
@option(
    "--workers",
    type=Count(1, 1024),
    metavar="N",
    help="Worker processes that share out the search for the worst case.  [default: 1]",
)
@dask_option
@quiet_option
def command(rig: str, json_out: str | None, report: str | None, quiet: bool, **options: Any) -> int:
    """Design the next test of RIG: at which frequencies to dwell, for how long, with which sensors.

    The values to design for are those of the rig file (value, guess), of --set, or of an estimate.  Standard
    deviations in per cent are of the values.  The duality gap that is printed proves how close to optimal the test is
    (equivalence theorem).
    """
    from dashpot.app.options import write_result
    from dashpot.check.structure import require_scale
    from dashpot.io.atomic import write_text
    from dashpot.model.rigfile import read_rig

    rig_read = read_rig(rig)
    require_scale(rig_read.model, rig_read.channels, rig)

    from dashpot.app.progress import progress
    from dashpot.app.workers import shared_out
    from dashpot.design.advise import answer
    from dashpot.design.plan_files import answer_to_json, plan_to_csv
    from dashpot.design.test_setup import drive_units

    question = _question(rig_read, options, quiet)
    with shared_out(options["dask"], options["workers"], small=True) as mapper, progress("design", quiet):
        result = answer(question, mapper=mapper)
    write_result(json_out, answer_to_json(result))
    if options["csv"] is not None and result.plan is not None:
        write_text(options["csv"], plan_to_csv(result.plan, drive_units(rig_read.model)))
    if report is not None:
        from dashpot.app.report_files import provenance, write_report
        from dashpot.present.pages.others import design_report

        write_report(report, design_report(result, provenance()))
    _draw(result, options["figure"], options["progress"], question)
    if not quiet and json_out != STDOUT:
        from dashpot.present.tables.design import show_answer
        from dashpot.present.tables.layout import console

        show_answer(result, console())
    return 0


def _question(rig: Rig, options: Mapping[str, Any], quiet: bool) -> Question:
    """What the options ask for, in SI units.  Raises UsageError where they contradict each other."""
    from dashpot.app.parameters import drive_amplitude, merged, parameter_values
    from dashpot.design.advise import Question
    from dashpot.errors import UsageError

    if options["samples"] is not None and options["time"] is not None:
        raise UsageError("both --samples and --time are given", cure="give one of them as the budget")
    _require_worst_case(options)
    data, earlier = _earlier(rig, options, quiet)
    if options["progress"] is not None and data is None:
        raise UsageError("--progress draws data as they came in", cure="give the data with --after DATA")
    estimate = None if options["estimate_file"] is None else _load(options["estimate_file"])
    values = parameter_values(rig, merged(options["settings"], "--set"))
    _require_masses(rig, values)
    if earlier is None and estimate is not None:
        unknowns = rig.model.unknown_names
        pairs = zip(estimate.names, estimate.values, strict=True)
        values = {**{name: float(value) for name, value in pairs if name in unknowns}, **values}
    criterion, target = _criterion(options["wanted"], options["target"])
    settling = options["settling_time"]
    return Question(
        model=rig.model,
        channels=_channels(rig, options["relative_noise"]),
        criterion=criterion,
        values=values,
        estimate=earlier,
        after=data,
        target=target,
        samples=options["samples"],
        time=options["time"],
        rate=options["rate"],
        settle=None if settling == "auto" else 0.0 if settling == "none" else settling,
        min_dwell=0.0 if options["min_dwell"] is None else options["min_dwell"],
        most=options["max_frequencies"],
        band=options["band"],
        step=options["grid"],
        limits=_limits(rig, options),
        amplitude=None if options["amplitude"] is None else drive_amplitude(rig.model, options["amplitude"]),
        drives=options["drives"],
        uncertainty=_uncertainty(rig, options, estimate),
        robustness="worst" if options["robust"] is None else options["robust"],
        pick=options["sensors"],
        against=None if options["against"] is None else _against(rig, options, quiet),
    )


def _require_worst_case(options: Mapping[str, Any]) -> None:
    """Raises UsageError where a search is to be shared out that nobody asks for."""
    from dashpot.errors import UsageError

    worst = options["doubt"] is not None if options["robust"] is None else options["robust"] == "worst"
    for name in ("workers", "dask"):
        if options[name] is not None and not worst:
            raise UsageError(
                f"--{name} shares out the search for the worst case, and none is asked for",
                cure="leave it out, or give --robust worst --doubt 30%",
            )


def _channels(rig: Rig, relative_noise: float | None) -> tuple[Channel, ...]:
    if relative_noise is None:
        return rig.channels
    from dashpot.model.observation import with_relative_noise

    return with_relative_noise(rig.model, rig.channels, relative_noise)


def _earlier(rig: Rig, options: Mapping[str, Any], quiet: bool) -> tuple[Spectrum | None, Estimate | None]:
    """Existing data, or one existing estimate."""
    from dashpot.app.data_files import read_spectrum
    from dashpot.errors import UsageError

    after: Sequence[str] = options["after"]
    estimates = [path for path in after if path.lower().endswith(".json")]
    if not after:
        return None, None
    if not estimates:
        return read_spectrum(rig, after, options, quiet), None
    if len(after) > 1:
        raise UsageError(
            "--after names an estimate and other files", cure="give either one estimate, or all the data"
        )
    return None, _load(estimates[0])


def _load(path: str) -> Estimate:
    from dashpot.estimate.result import Estimate

    return Estimate.load(path)


def _require_masses(rig: Rig, values: Mapping[str, float]) -> None:
    from dashpot.errors import UsageError

    units = {unknown.name: unknown.unit for unknown in rig.model.unknowns}
    for name, value in values.items():
        if value < 0 and units[name] == "kg":
            raise UsageError(f"--set {name}: a mass of {value:g} kg", rig.path, "give a positive mass")


def _criterion(wanted: str, target: float | Mapping[str, float] | None) -> tuple[Criterion, float | None]:
    """The criterion of --for and --target, and the figure to reach."""
    from dashpot.design.allocation import Criterion
    from dashpot.errors import UsageError

    if isinstance(target, Mapping):
        if wanted != "all":
            raise UsageError(
                "--for and a --target by names are both given",
                cure="the targets already say what should be precise",
            )
        return Criterion("minimax", targets=target), 1.0
    criteria: dict[str, Criterion] = {
        "all": Criterion("A"),
        "worst": Criterion("minimax"),
        "volume": Criterion("D"),
    }
    if wanted in criteria:
        return criteria[wanted], target
    unknowns = names(wanted)
    if not unknowns:
        raise UsageError("--for names nothing", cure="write all, worst, volume, or names such as c2,m1")
    return Criterion("A", unknowns), target


def _limits(rig: Rig, options: Mapping[str, Any]) -> ShakerLimits:
    from dashpot.app.parameters import input_is_angular
    from dashpot.design.test_setup import ShakerLimits

    angular = input_is_angular(rig.model)

    def limit(name: str, quantity: str) -> float | None:
        amount: Amount | None = options[name]
        return None if amount is None else amount.si(quantity, angular)

    return ShakerLimits(
        limit("stroke", "displacement"),
        limit("max_velocity", "velocity"),
        limit("max_acceleration", "acceleration"),
        limit("max_force", "force"),
    )


def _uncertainty(
    rig: Rig, options: Mapping[str, Any], estimate: Estimate | None
) -> float | GaussianPrior | Literal["estimate"] | None:
    """A share of every value, or the covariance of --estimate, or of what --after says."""
    from dashpot.design.stopping import gaussian_prior_of
    from dashpot.errors import UsageError

    doubt: float | None = options["doubt"]
    if options["robust"] is None or doubt is not None:
        return doubt
    if estimate is not None:
        return gaussian_prior_of(rig.model, estimate)
    if not options["after"]:
        raise UsageError(
            "--robust needs to know how wrong the values may be",
            cure="give --doubt 30%, or --estimate or --after, whose covariance is used",
        )
    return "estimate"


def _against(rig: Rig, options: Mapping[str, Any], quiet: bool) -> tuple[float, ...] | Spectrum:
    """A list of frequencies, or the lines of a file."""
    from dashpot.app.data_files import read_spectrum
    from dashpot.errors import UsageError
    from dashpot.quantities import frequencies

    text: str = options["against"]
    if os.path.exists(text):  # a text too long for a path is none, where Path.exists fails
        return read_spectrum(rig, (text,), options, quiet)
    try:
        return frequencies(text)
    except UsageError as error:
        problem = error.problems[0]
        raise UsageError(
            f"--against: {problem.what}", cure=f"{problem.cure}, or name a file that exists"
        ) from None


def _draw(result: Answer, figure_out: str | None, progress_out: str | None, question: Question) -> None:
    if figure_out is None and progress_out is None:
        return
    from dashpot.present.figures.design import planned_test_figure, sequential_figure
    from dashpot.present.figures.style import write_figure

    if figure_out is not None and result.plan is not None:
        write_figure(figure_out, planned_test_figure(result))
    if progress_out is not None:
        aim = question.target
        targets = {} if aim is None else question.criterion.targets_for(question.model, aim)
        drawn = sequential_figure(result, targets)
        if drawn is not None:
            write_figure(progress_out, drawn)
