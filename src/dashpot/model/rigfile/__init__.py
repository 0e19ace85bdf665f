"""Rig files: TOML that describes a model and what its channels measure.

    rig = read_rig("rig.toml")        rig.model, rig.channels
    text = write_rig(rig)             reads back to the same rig

Whatever is wrong with a file is a ModelError with all its problems, each at `rig.toml:8: springs.k1`.
"""

from dashpot.model.rigfile.reader import parse_rig, read_rig
from dashpot.model.rigfile.rig import Rig, default_channels
from dashpot.model.rigfile.schema import SECTIONS
from dashpot.model.rigfile.writer import (
    channel_line,
    channel_section,
    edited,
    element_line,
    element_section,
    write_rig,
)

__all__ = [
    "SECTIONS",
    "Rig",
    "channel_line",
    "channel_section",
    "default_channels",
    "edited",
    "element_line",
    "element_section",
    "parse_rig",
    "read_rig",
    "write_rig",
]
