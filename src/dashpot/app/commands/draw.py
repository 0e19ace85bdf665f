"""dashpot draw: the rig as a schematic, with the values of an estimate, or one of its modes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dashpot.app.options import (
    INPUT_FILE,
    Count,
    dashpot_command,
    level_option,
    option,
    out_option,
    rig_argument,
)
from dashpot.io.words import PICTURES

if TYPE_CHECKING:
    from dashpot.estimate.result import Estimate
    from dashpot.model.rigfile import Rig

WHAT = "What to draw"


@dashpot_command(
    "draw",
    "dashpot draw rig.toml -o rig.svg",
    "dashpot draw rig.toml --estimate estimate.json -o rig.pdf",
    "dashpot draw rig.toml --estimate estimate.json --mode 2 -o mode2.svg",
)
@rig_argument
@option(
    "--estimate", "estimate_file", type=INPUT_FILE, metavar="FILE.json", group=WHAT,
    help="An estimate (JSON of identify), whose values and intervals are written beside the elements.",
)  # fmt: skip
@option(
    "--mode",
    type=Count(1, 10_000),
    metavar="N",
    group=WHAT,
    help="Draw mode N: of the estimate, or of a rig file that gives every value or guess.  In SVG it is animated.",
)
@out_option("FILE.svg|png|pdf", "The drawing.", formats=PICTURES)
@level_option
def command(rig: str, estimate_file: str | None, mode: int | None, out: str, level: float) -> None:
    """Draw RIG: masses, springs, dampers, inputs and sensors.

    Heavy lines are unknown (or found, with an estimate), thin ones known; broken ones are in doubt: the interval is
    wider than half the value or, without an estimate, the channels cannot determine them.
    """
    from dashpot.check.data_findings import doubtful, undetermined
    from dashpot.estimate.result import Estimate
    from dashpot.model.rigfile import read_rig
    from dashpot.present.schematic.drawing import schematic

    rig_read = read_rig(rig)
    estimate = None if estimate_file is None else Estimate.load(estimate_file)
    if estimate is not None:
        estimate.require_unknowns([unknown.name for unknown in rig_read.model.unknowns])
    if mode is not None:
        _draw_mode(rig_read, estimate, mode, out)
        return
    model, channels = rig_read.model, rig_read.channels
    marks = undetermined(model, channels) if estimate is None else doubtful(estimate, level)
    schematic(model, channels, estimate, marks, level).save(out)


def _draw_mode(rig: Rig, estimate: Estimate | None, mode: int, out: str) -> None:
    from dashpot.present.schematic.drawing import mode_drawing, numbered_mode

    title, shape = numbered_mode(rig.model, estimate, mode)
    mode_drawing(rig.model, shape, title).save(out)
