"""The commands, one module each.

A new command is a module here with a function `command` that is a click command, and a line in COMMANDS.  Modules
are imported when their command is called, and import numpy, scipy, rich and the rest only inside the function: that
keeps `dashpot --help` instant.
"""

from __future__ import annotations

from collections.abc import Mapping

# Name → what `dashpot --help` says of it, in the order of a day's work.
COMMANDS: Mapping[str, str] = {
    "identify": "Estimate the unknown masses, dampers and springs of a rig from test data.",
    "validate": "Predict records with an estimate made from other records.",
    "compare": "Compare several estimators on the same data.",
    "check": "Check what the channels and the data can determine, and what they cannot.",
    "simulate": "Write the test data that a rig with given parameters would yield.",
    "draw": "Draw a rig as a schematic, with the values of an estimate, or one of its modes.",
    "export": "Export a rig with its estimate to another program: MATLAB, FMU, MuJoCo and more.",
    "response": "Follow the settled motion of a nonlinear rig through folds, and draw it.",
    "start": "Show what is in data files, and write a rig file for them.",
    "new": "Write a rig file to start from.",
    "inspect": "Show what is in data files, and suggest channels for a rig file.",
    "spectrum": "Turn time records into a table of complex amplitudes.",
    "frf": "Frequency responses from test data, with standard deviations, without a rig.",
    "modes": "Natural frequencies, damping and shapes from test data, without a rig.",
    "track": "Follow the unknowns of a rig over time, and say when they change.",
    "fleet": "Estimate the unknowns of many rigs of one kind, each from its own data.",
    "study": "Compare tests, noise levels and methods by Monte Carlo simulation.",
    "design": "Design the next test: the most informative frequencies, times and sensors.",
    "serve": "Serve a page in the browser: drop files, identify, correct the rig, plan the next test.",
    "reproduce": "Reproduce the tables and figures of a published paper.",
    "completion": "Print the script that lets a shell complete dashpot commands.",
}
