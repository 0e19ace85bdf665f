"""dashpot design: the next test, its frequencies, times and sensors, and the intervals that it will give."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

import click

from dashpot.app import options as opt
from dashpot.app.data_files import RecordOptions
from dashpot.app.options import drive_amplitude, parameter_values
from dashpot.app.report_files import ReportFile
from dashpot.app.workers import progress, shared_out
from dashpot.errors import UsageError
from dashpot.io.atomic import write_text
from dashpot.io.json_document import to_json
from dashpot.io.words import PICTURES
from dashpot.quantities import Amount, frequencies

if TYPE_CHECKING:
    from dashpot.data.spectrum import Spectrum
    from dashpot.design.advise import Answer, Question
    from dashpot.design.allocation import Criterion
    from dashpot.design.robust import GaussianPrior
    from dashpot.estimate.result import Estimate
    from dashpot.model.rigfile import Rig

BUDGET, AIM = "Size of the test", "Aim of the test"
BASIS = "What is known"
TEST, SHAKER, ROBUST = "The test", "The shaker", "Robustness"


@dataclass(frozen=True)
class DesignOptions:
    """What is to be designed, from what, and within which limits."""

    samples: Annotated[
        int | None, opt.Option("--samples N", opt.Count(1), BUDGET), "Samples of the whole test."
    ]
    time: Annotated[
        float | None,
        opt.Option("--time 10min", opt.TIME, BUDGET),
        "Duration of the whole test, settling included.",
    ]
    target: Annotated[
        float | dict[str, float] | None,
        opt.Option("--target 1%|c2=2%,…", opt.TARGET, BUDGET),
        "Relative standard deviation to reach; without --samples and --time the shortest test that reaches it "
        "is designed.",
    ]
    aim: Annotated[
        str,
        opt.Option("--for all|worst|volume|NAME,…", None, AIM, default="all"),
        "What should be precise: all unknowns on average (all), the worst one (worst), the volume of the "
        "confidence region (volume), or the unknowns named.",
    ]
    sensors: Annotated[
        tuple[int, tuple[str, ...]] | None,
        opt.Option('--sensors "pick 3 of a,b,…"', opt.SENSORS, AIM),
        "Choose the best few of these channels; channels that are not listed are kept.",
    ]
    against: Annotated[
        str | None,
        opt.Option("--against FILE|LIST|RANGE", opt.INPUT_FILE_OR, AIM),
        "Compare with another test: a data file, or frequencies in Hz as 1,2,5, 1:10:0.5 or 1:10/25.",
    ]
    settings: Annotated[tuple[dict[str, Amount], ...], opt.SET, "Values to design for", BASIS]
    estimate_file: Annotated[
        str | None,
        opt.Option("--estimate FILE.json", opt.INPUT_FILE, BASIS),
        "Take the values to design for from an estimate, without counting it as data.",
    ]
    after: Annotated[
        tuple[str, ...],
        opt.Option("--after DATA|FILE.json", opt.INPUT_FILE, BASIS, multiple=True),
        "Existing data or estimate to build on.  May be repeated.",
    ]
    # Also the value of the field of this name in RecordOptions, whose --band would mean another thing here.
    record_band: Annotated[
        tuple[float, float] | None,
        opt.Option("--record-band LOWER:UPPER", opt.BAND, BASIS),
        "Frequencies of the continuous records of --after that are used, Hz.  "
        "[default: the band in which the rig moves]",
    ]
    relative_noise: Annotated[opt.RelativeNoise, BASIS]
    band: Annotated[
        tuple[float, float] | None,
        opt.Option("--band LOWER:UPPER", opt.BAND, TEST),
        "Frequencies to choose from, Hz.  [default: around the resonances]",
    ]
    grid: Annotated[
        float | None, opt.Option("--grid HZ", opt.FREQUENCY, TEST), "Use only multiples of this frequency."
    ]
    max_frequencies: Annotated[
        int | None, opt.Option("--max-frequencies N", opt.Count(1, 10_000), TEST), "Largest number of dwells."
    ]
    min_dwell: Annotated[float | None, opt.Option("--min-dwell 5s", opt.TIME, TEST), "Shortest dwell."]
    settling_time: Annotated[
        Any,
        opt.Option("--settling-time auto|none|2s", opt.SETTLING, TEST, default="auto"),
        "Wait before each dwell; auto takes three decades of the decay of the slowest mode.",
    ]
    rate: Annotated[
        float | None,
        opt.Option("--rate HZ", opt.FREQUENCY, TEST),
        "Sampling rate.  [default: that of the rig file]",
    ]
    stroke: Annotated[
        Amount | None, opt.Option("--stroke 5mm", opt.AMOUNT, SHAKER), "Largest displacement amplitude."
    ]
    max_velocity: Annotated[
        Amount | None, opt.Option("--max-velocity 0.5m/s", opt.AMOUNT, SHAKER), "Largest velocity amplitude."
    ]
    max_acceleration: Annotated[
        Amount | None,
        opt.Option("--max-acceleration 2gn", opt.AMOUNT, SHAKER),
        "Largest acceleration amplitude.",
    ]
    max_force: Annotated[
        Amount | None,
        opt.Option("--max-force 100N", opt.AMOUNT, SHAKER),
        "Largest force amplitude; for a moved base, of the force that moves it.",
    ]
    amplitude: Annotated[
        Amount | dict[str, Amount] | None,
        opt.Option("--amplitude [INPUT=]VALUE", opt.AMPLITUDE, SHAKER),
        "Amplitude of the drive, where no limit is given.",
    ]
    drives: Annotated[
        tuple[str, ...],
        opt.Option("--drive u,-v", None, SHAKER, multiple=True),
        "Inputs that move together, in phase or (with -) in antiphase.  May be repeated.",
    ]
    doubt: Annotated[
        float | None, opt.Option("--doubt 30%", opt.SHARE, ROBUST), "Uncertainty of the values to design for."
    ]
    robust: Annotated[
        Literal["worst", "average"] | None,
        opt.Option("--robust", click.Choice(["worst", "average"]), ROBUST),
        "Optimise the worst case over --doubt, or the average.  Without --doubt, the covariance of --estimate "
        "or --after is used.",
    ]

    def __post_init__(self) -> None:
        """Raises UsageError if two options contradict each other."""
        if self.samples is not None and self.time is not None:
            raise UsageError("both --samples and --time are given", cure="give one of them as the budget")
        if self.record_band is not None and not self.after and self.against is None:
            cure = "give --after, or leave it out"
            raise UsageError("--record-band is for the records of --after, and there are none", cure=cure)


@opt.dashpot_command(
    "dashpot design rig.toml --samples 1400 --set m1=3,c1=30",
    "dashpot design rig.toml --after data.csv --target 1% --rate 500 --stroke 5mm --json plan.json",
    'dashpot design rig.toml --time 10min --rate 500 --sensors "pick 2 of x1,x2,acc3" --against 2:10/5',
)
def command(
    rig: opt.RigFile,
    wanted: DesignOptions,
    json_out: Annotated[str | None, opt.JSON, "the plan"],
    csv: Annotated[
        str | None,
        opt.Option("--csv FILE.csv", opt.OutputFile(), opt.OUTPUT),
        "Write the dwells for the shaker's controller.",
    ],
    figure: Annotated[str | None, opt.FIGURE, "Draw dwells, information and the expected intervals."],
    drawn_progress: Annotated[
        str | None,
        opt.Option("--progress FILE.svg|png|pdf", opt.OutputFile(formats=PICTURES), opt.OUTPUT),
        "Draw how the intervals shrank as the data of --after came in.",
    ],
    report: ReportFile,
    records: RecordOptions,
    workers: Annotated[
        int | None,
        opt.Option("--workers N", opt.Count(1, 1024)),
        "Worker processes for the worst-case search.  [default: 1]",
    ],
    dask: opt.Dask,
    experiment: opt.Experiment,
    quiet: opt.Quiet,
) -> int:
    """Design the next test of RIG: at which frequencies to dwell, for how long, with which sensors.

    The values to design for are those of the rig file (value, guess), of --set, or of an estimate.  Standard
    deviations in per cent are of the values.  The duality gap that is printed proves how close to optimal the test is
    (equivalence theorem).  A rig without inputs gets a plan of releases: where to hold it, how far (--stroke), how
    long to record, and which releases to combine.
    """
    from dashpot.check.structure import require_scale
    from dashpot.design.advise import answer, answer_to_json, plan_to_csv
    from dashpot.design.test_setup import drive_units
    from dashpot.model.rigfile import read_rig
    from dashpot.present.design import answer_document, design_report

    read = read_rig(rig)
    whole, read = read, read.standing_in(experiment) if wanted.after else read.in_experiment(experiment)
    require_scale(read.model, read.channels, rig)
    if not read.model.inputs:
        others = {"--csv": csv, "--figure": figure, "--progress": drawn_progress, "--report": report or None}
        return _releases(read, wanted, others, json_out, quiet)
    for name, given in (("--workers", workers), ("--dask", dask)):
        worst = wanted.doubt is not None if wanted.robust is None else wanted.robust == "worst"
        if given is not None and not worst:
            raise UsageError(
                f"{name} is for the search of the worst case",
                cure="leave it out, or give --robust worst --doubt 30%",
            )
    question = _question(read, whole, wanted, records)
    if drawn_progress is not None and question.after is None:
        raise UsageError("--progress draws data as they came in", cure="give the data with --after DATA")
    with shared_out(dask, workers, small=True) as mapper, progress("design", quiet):
        result = answer(question, mapper=mapper)
    if csv is not None and result.plan is not None:
        write_text(csv, plan_to_csv(result.plan, drive_units(read.model)))
    if report:
        report.write(design_report(result, report.provenance))
    _draw(result, figure, drawn_progress, question)
    opt.tell_result(json_out, answer_to_json(result), lambda: answer_document(result), quiet, apart=True)
    return 0


def _releases(
    rig: Rig, wanted: DesignOptions, others: Mapping[str, object], json_out: str | None, quiet: bool
) -> int:
    """The releases of a rig that nothing drives."""
    from dashpot.check.deficiencies import require_identifiable
    from dashpot.design.releases import plan_releases
    from dashpot.estimate.result import Estimate
    from dashpot.model.observation import with_relative_noise
    from dashpot.present.design import release_document

    driven: dict[str, object] = {
        "--sensors": wanted.sensors,
        "--against": wanted.against,
        "--after": wanted.after or None,
    }
    driven |= {"--record-band": wanted.record_band}
    driven |= {"--band": wanted.band, "--grid": wanted.grid, "--max-frequencies": wanted.max_frequencies}
    driven |= {
        "--min-dwell": wanted.min_dwell,
        "--amplitude": wanted.amplitude,
        "--drive": wanted.drives or None,
    }
    driven |= {"--doubt": wanted.doubt, "--robust": wanted.robust, "--max-force": wanted.max_force}
    driven |= {"--max-velocity": wanted.max_velocity, "--max-acceleration": wanted.max_acceleration}
    for name, given in (driven | dict(others)).items():
        if given is not None:
            cure = "leave it out, or add an input to the rig file"
            if name == "--after":
                cure = "give --estimate FILE.json for the values; earlier tests do not count in plans of releases"
            raise UsageError(f"{name} is for driven rigs, and this rig has no input", cure=cure)
    criterion, target = _criterion(wanted.aim, wanted.target)
    if criterion.targets is not None or criterion.kind == "D":
        raise UsageError(
            "releases are planned for an rms or a worst error", cure="write --for all, worst or names"
        )
    require_identifiable(rig.model, rig.channels, rig.path)
    time = wanted.time
    if wanted.samples is not None:
        if wanted.rate is None:
            raise UsageError("--samples of releases need --rate", cure="give it, or --time")
        time = wanted.samples / wanted.rate
    turning = set(rig.model.coordinates) <= set(rig.model.angles)
    channels, noise = rig.channels, wanted.relative_noise
    estimate = None if wanted.estimate_file is None else Estimate.load(wanted.estimate_file)
    values = _values(rig, wanted.settings, estimate)
    with progress("design", quiet):
        plan = plan_releases(
            rig.model,
            channels if noise is None else with_relative_noise(rig.model, channels, noise),
            values,
            names=criterion.names,
            worst=criterion.kind == "minimax",
            deflection=None if wanted.stroke is None else wanted.stroke.si("displacement", turning),
            rate_hz=wanted.rate,
            time_s=time,
            target=target,
        )
    opt.tell_result(json_out, to_json(plan.content()), lambda: release_document(plan), quiet, apart=True)
    return 0


def _values(
    rig: Rig, settings: Sequence[Mapping[str, Amount]], estimate: Estimate | None
) -> dict[str, float]:
    """Values to design for: of --set, else of the estimate."""
    found = {} if estimate is None else dict(zip(estimate.names, estimate.values.tolist(), strict=True))
    known = {name: value for name, value in found.items() if name in rig.model.unknown_names}
    return known | parameter_values(rig, settings)


def _question(rig: Rig, whole: Rig, wanted: DesignOptions, records: RecordOptions) -> Question:
    """What the options ask for, in SI units, of a rig as it is in one experiment of the `whole` rig.

    Raises UsageError if they contradict each other.
    """
    from dashpot.design.advise import Question
    from dashpot.estimate.result import Estimate
    from dashpot.model.observation import with_relative_noise
    from dashpot.model.rigfile.rig import ShakerLimits, drive_is_angular

    estimates = [path for path in wanted.after if path.lower().endswith(".json")]
    if not estimates:
        data, earlier = (records.read(whole, wanted.after) if wanted.after else None), None
    else:
        if len(wanted.after) > 1:
            raise UsageError(
                "--after names an estimate and other files", cure="give either one estimate, or all the data"
            )
        data, earlier = None, Estimate.load(estimates[0])
    estimate = None if wanted.estimate_file is None else Estimate.load(wanted.estimate_file)
    values = parameter_values(rig, wanted.settings)
    units = {unknown.name: unknown.unit for unknown in rig.model.unknowns}
    for name, value in values.items():
        if value < 0 and units[name] == "kg":
            raise UsageError(f"--set {name}: a mass of {value:g} kg", rig.path, "give a positive mass")
    if earlier is None:
        values = _values(rig, wanted.settings, estimate)
    criterion, target = _criterion(wanted.aim, wanted.target)
    channels, noise = rig.channels, wanted.relative_noise
    settling = wanted.settling_time
    limits = {
        "displacement": wanted.stroke,
        "velocity": wanted.max_velocity,
        "acceleration": wanted.max_acceleration,
        "force": wanted.max_force,
    }
    stated: dict[str, Any] = {
        "stroke" if kind == "displacement" else kind: given.si(kind, drive_is_angular(rig.model, kind))
        for kind, given in limits.items()
        if given is not None
    }
    return Question(
        model=rig.model,
        channels=channels if noise is None else with_relative_noise(rig.model, channels, noise),
        criterion=criterion,
        values=values,
        estimate=earlier,
        after=data,
        target=target,
        samples=wanted.samples,
        time=wanted.time,
        rate=wanted.rate,
        settle=None if settling == "auto" else 0.0 if settling == "none" else settling,
        min_dwell=0.0 if wanted.min_dwell is None else wanted.min_dwell,
        most=wanted.max_frequencies,
        band=wanted.band,
        step=wanted.grid,
        limits=replace(rig.shaker or ShakerLimits(), **stated),
        amplitude=None if wanted.amplitude is None else drive_amplitude(rig.model, wanted.amplitude),
        drives=wanted.drives,
        uncertainty=_uncertainty(rig, wanted, estimate),
        robustness="worst" if wanted.robust is None else wanted.robust,
        pick=wanted.sensors,
        against=None if wanted.against is None else _against(rig, wanted.against, records),
    )


def _criterion(wanted: str, target: float | Mapping[str, float] | None) -> tuple[Criterion, float | None]:
    """The criterion of --for and --target, and the figure to reach."""
    from dashpot.design.allocation import Criterion

    if isinstance(target, Mapping):
        if wanted != "all":
            raise UsageError(
                "--for and a --target by names are both given",
                cure="the targets already say what should be precise",
            )
        return Criterion("minimax", targets=target), 1.0
    if wanted == "all":
        return Criterion("A"), target
    if wanted in ("worst", "volume"):
        return Criterion("minimax" if wanted == "worst" else "D"), target
    unknowns = opt.names(wanted)
    if not unknowns:
        raise UsageError("--for names nothing", cure="write all, worst, volume, or names such as c2,m1")
    return Criterion("A", unknowns), target


def _uncertainty(
    rig: Rig, wanted: DesignOptions, estimate: Estimate | None
) -> float | GaussianPrior | Literal["estimate"] | None:
    """A share of every value, or the covariance of --estimate, or of what --after says."""
    from dashpot.design.stopping import gaussian_prior_of

    if wanted.robust is None or wanted.doubt is not None:
        return wanted.doubt
    if estimate is not None:
        return gaussian_prior_of(rig.model, estimate)
    if not wanted.after:
        raise UsageError(
            "--robust needs the uncertainty of the values",
            cure="give --doubt 30%, or --estimate or --after, whose covariance is used",
        )
    return "estimate"


def _against(rig: Rig, text: str, records: RecordOptions) -> tuple[float, ...] | Spectrum:
    """A list of frequencies, or the lines of a file."""
    if os.path.exists(text):  # a text too long for a path is none, where Path.exists fails
        return records.read(rig, (text,))
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
