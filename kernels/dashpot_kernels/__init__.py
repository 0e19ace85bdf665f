"""The hot loops of dashpot in C++; `dashpot.numerics.kernel` chooses between them and their NumPy twins."""

from dashpot_kernels._core import (
    Equation,
    NonlinearRig,
    Output,
    Records,
    Rig,
    StateLaws,
    instruction_set,
    instruction_sets,
    line_shares,
    mode_values,
    point_states,
    scaled_inverse,
    set_instructions,
)

__all__ = [
    "Equation",
    "NonlinearRig",
    "Output",
    "Records",
    "Rig",
    "StateLaws",
    "instruction_set",
    "instruction_sets",
    "line_shares",
    "mode_values",
    "point_states",
    "scaled_inverse",
    "set_instructions",
]
__version__ = "0.4.0"
