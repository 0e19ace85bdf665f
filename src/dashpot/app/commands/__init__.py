"""The commands, one module each.

A new command is a module here with a function `command` that is a click command, and a line in COMMANDS.  Modules
are imported when their command is called, and import numpy, scipy, rich and the rest only inside the function: that
keeps `dashpot --help` instant.
"""

from __future__ import annotations

from collections.abc import Mapping

# Name → what `dashpot --help` says of it, in the order of a day's work.
COMMANDS: Mapping[str, str] = {
    "identify": "Find the unknown masses, dampers and springs of a rig from test data.",
    "compare": "Put several estimators side by side on the same data.",
    "check": "Say what of a rig can be found, before data and with them.",
    "simulate": "Write the test data that a rig with given parameters would yield.",
    "spectrum": "Turn time records into a table of complex amplitudes.",
    "study": "Compare tests, noises and methods by Monte Carlo.",
    "design": "Find the next test: frequencies, times and sensors that tell most.",
    "reproduce": "Redo the tables and figures of a published paper.",
}
