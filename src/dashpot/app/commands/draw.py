"""dashpot draw: the rig as a schematic, with the values of an estimate, or one of its modes."""

from __future__ import annotations

from typing import Annotated

from dashpot.app import options as opt
from dashpot.io.words import PICTURES

WHAT = "What to draw"


@opt.dashpot_command(
    "dashpot draw rig.toml -o rig.svg",
    "dashpot draw rig.toml --estimate estimate.json -o rig.pdf",
    "dashpot draw rig.toml --estimate estimate.json --mode 2 -o mode2.svg",
)
def command(
    rig: opt.RigFile,
    estimate_file: Annotated[
        str | None,
        opt.Option("--estimate FILE.json", opt.INPUT_FILE, WHAT),
        "An estimate (JSON of identify), whose values and intervals are written next to the elements.",
    ],
    mode: Annotated[
        int | None,
        opt.Option("--mode N", opt.Count(1, 10_000), WHAT),
        "Draw mode N: of the estimate, or of a rig file that gives every value or guess.  In SVG it is animated.",
    ],
    out: Annotated[
        str,
        opt.Option("--out -o FILE.svg|png|pdf", opt.OutputFile(formats=PICTURES), opt.OUTPUT, required=True),
        "The drawing.",
    ],
    level: opt.Level,
    experiment: opt.Experiment,
) -> None:
    """Draw RIG: masses, springs, dampers, inputs and sensors.

    Heavy lines are unknown (or found, with an estimate), thin ones known; broken ones are in doubt: the interval is
    wider than half the value or, without an estimate, the channels cannot determine them.
    """
    from dashpot.api import draw
    from dashpot.estimate.result import Estimate
    from dashpot.model.rigfile import read_rig

    read = read_rig(rig).in_experiment(experiment)
    estimate = None if estimate_file is None else Estimate.load(estimate_file)
    if estimate is not None:
        estimate.require_unknowns([unknown.name for unknown in read_rig(rig).model.unknowns])
    draw(read, estimate, mode=mode, level=level).save(out)
