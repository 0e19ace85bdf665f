"""The commands, one module each.

A new command is a module here with a function `command` that is a click command, and a line in COMMANDS.  Modules
are imported when their command is called, and import numpy, scipy, rich and the rest only inside the function: that
keeps `dashpot --help` instant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

OTHER = "Other"
# What `dashpot --help` says of each command, under headings, in the order of a day's work.
GROUPS: Sequence[tuple[str, Mapping[str, str]]] = (
    (
        "Describe the rig",
        {
            "start": "Show what is in data files and write a rig file for them.",
            "new": "Write a rig file to start from.",
            "inspect": "Show what is in data files and suggest channels for a rig file.",
            "draw": "Draw a rig, with the values of an estimate or one of its modes.",
        },
    ),
    (
        "Identify and judge",
        {
            "check": "Check which unknowns the channels and the data can determine.",
            "identify": "Estimate the unknown masses, dampers and springs of a rig from test data.",
            "validate": "Predict records that the estimate was not made from.",
            "compare": "Compare estimators, or nonlinear elements, on the same data.",
        },
    ),
    (
        "Plan the next test",
        {
            "design": "Design the next test: the most informative frequencies, times and sensors.",
            "simulate": "Write the test data that a rig with given parameters would produce.",
            "study": "Compare tests, noise levels and methods by Monte Carlo simulation.",
        },
    ),
    (
        "Without a rig file",
        {
            "frf": "Frequency responses from test data, with standard deviations.",
            "modes": "Natural frequencies, damping and mode shapes from test data.",
            "spectrum": "Turn time records into a table of complex amplitudes.",
        },
    ),
    (
        "Many rigs, long times",
        {
            "fleet": "Estimate the unknowns of many rigs of one kind, each from its own data.",
            "track": "Track the unknowns of a rig over time and report changes.",
        },
    ),
    (
        "Use the result",
        {
            "export": "Export a rig and its estimate to MATLAB, FMU, MuJoCo and other formats.",
            "response": "Compute response curves of a nonlinear rig, unstable branches included.",
            "serve": "Serve a page in the browser: drop files, identify, correct the rig, plan the next test.",
        },
    ),
    (
        OTHER,
        {
            "reproduce": "Reproduce the tables and figures of a published paper.",
            "completion": "Print the script for shell completion of dashpot commands.",
        },
    ),
)
COMMANDS: Mapping[str, str] = {name: text for _, group in GROUPS for name, text in group.items()}
