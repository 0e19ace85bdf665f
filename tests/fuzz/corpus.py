"""Sound inputs of every kind, small ones, from which damaged ones are made."""

import contextlib
import io
import json
import os
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import openpyxl

from dashpot.app.cli import run
from dashpot.data.readers.uff import NodalMode
from dashpot.data.readers.uff_writer import write_universal_file
from tests import two_masses
from tests.unit.data.readers.attacks import ATTACKS, write_hdf5
from tests.unit.data.readers.famos_bytes import dwell
from tests.unit.data.readers.written import WRITERS, recording, wav

BASE = (
    two_masses.RIG.replace("value = 2.7", "value = 2.7, sd = 0.01")
    .replace('c1 = { between = ["x1", "x2"]', 'c1 = { between = ["x1", "x2"], guess = 20')
    .replace('c2 = { between = ["x2", "u"]', 'c2 = { between = ["x2", "u"], guess = 30')
)

FORCED = """\
coordinates = ["x", "pitch"]
angles = ["pitch"]
[inputs]
u = {}
f = { kind = "force", at = { x = 1, pitch = -0.3 } }
[masses]
m = { at = "x", value = 12, unit = "lb" }
J = { at = "pitch", value = 0.5, unit = "kg m^2" }
tip = { along = { x = 1, pitch = 0.5 }, value = 0.1 }
[springs]
front = { along = { x = 1, pitch = 0.4, u = -1 }, guess = 10, unit = "N/mm" }
rear = { along = { x = 1, pitch = -0.4, u = -1 }, same_as = "front", times = 2 }
[dampers]
cf = { between = ["x", "u"], unit = "kg/s", guess = 40, min = 0, max = 1e4 }
cp = { at = "pitch", guess = 1 }
[inerters]
b = { between = ["x", "u"], value = 0.1 }
[hysteretic]
h = { at = "x", value = 2, unit = "kN/m" }
[channels]
x = { of = "x", quantity = "acceleration", unit = "g", noise = 0.01 }
pitch = { of = "pitch", unit = "deg", noise = 0.01 }
spring = { of = "front", unit = "N", noise = 0.1 }
u = { of = "u", unit = "mm" }
f = { of = "f", unit = "lbf" }
"""

FREE = """\
coordinates = ["x1", "x2"]
[inputs]
f = { kind = "force", at = "x1" }
[free]
M = "diagonal"
C = "full"
K = [["x1", "x2"]]
[channels]
x1 = { of = "x1" }
x2 = { of = "x2" }
f = { of = "f" }
"""

NONLINEAR = """\
coordinates = ["x1", "x2"]
[inputs]
u = {}
[masses]
m1 = { at = "x1", value = 3 }
m2 = { at = "x2", guess = 2.7 }
[springs]
k1 = { between = ["x1", "x2"], guess = 4600 }
cubic = { between = ["x1", "x2"], law = "d**3", guess = 1e7 }
k2 = { between = ["x2", "u"], value = 4600, law = "d*(1 + (d/d0)**2)", d0 = { value = 0.01, sd = 0.001, min = 0 } }
[dampers]
c1 = { between = ["x1", "x2"], guess = 20 }
fc = { between = ["x2", "u"], law = "tanh(v/v0)", guess = 2, v0 = { guess = 0.05, min = 1e-4, max = 1 } }
[channels]
x1 = { of = "x1", unit = "mm" }
x2 = { of = "x2", unit = "mm" }
u = { of = "u", unit = "counts", bits = 16, full_scale = "20 mm" }
"""

MODES_CSV = """\
frequency_hz,frequency_sd,damping_ratio,damping_sd,x1_re,x1_im,x1_sd,x2_re,x2_im,x2_sd
3.9,0.01,0.1,0.001,1,0,0.01,0.6,-0.01,0.02
10.5,0.02,0.2,0.002,-0.6,0.1,0.01,1,0,0.01
"""

MODES_JSON = json.dumps(
    {
        "modes": [
            {"frequency_hz": 3.9, "frequency_sd": 0.01, "damping_ratio": 0.1, "damping_sd": 0.001,
             "shape": {"x1": [1.0, 0.0], "x2": 0.6}, "shape_sd": {"x1": 0.01, "x2": 0.02}},
            {"frequency_hz": 10.5, "frequency_sd": 0.02, "shape": {"x1": [-0.6, 0.1], "x2": 1},
             "shape_sd": {"x1": 0.01, "x2": 0.02}},
        ]
    },
    indent=1,
)  # fmt: skip

MANIFEST = """\
[conditioning]
settle = "none"
drift = 0
[[files]]
name = "records.csv"
columns = { x1 = "x1", x2 = "x2", u = "u" }
units = { x1 = "mm" }
experiment = 2
band_hz = "2:12"
"""

FRF = "frequency_hz,x1/u_re,x1/u_im,x1/u_sd,x2/u_re,x2/u_im,x2/u_sd\n" + "".join(
    f"{f},{1 + 0.1 * f},{-0.05 * f},0.01,{1 + 0.05 * f},{-0.02 * f},0.01\n"
    for f in (1, 2, 3, 4, 6, 8, 10, 12)
)

LVM = """\
LabVIEW Measurement\t
Separator\tTab
Decimal_Separator\t.
X_Columns\tOne
***End_of_Header***\t
\t
Channels\t3\t\t\t
Delta_X\t0.01\t0.01\t0.01\t
***End_of_Header***\t\t\t\t
X_Value\tx1\tx2\tu\tComment
""" + "".join(f"{k / 100:.6f}\t{0.5 + k % 7}\t{0.1 * (k % 5)}\t{k % 3}\t\n" for k in range(60))

XSENS = "sep=,\nDeviceTag:,Xsens DOT\n\nPacketCounter,SampleTimeFine,Euler_X,Acc_X,Acc_Y,Acc_Z\n" + "".join(
    f"{k},{1000 + 8333 * k},0.5,{0.1 * (k % 7):.3f},1.0,9.8\n" for k in range(40)
)


@cache
def files() -> dict[str, bytes]:
    """All sound files by their names; data are simulated from the rigs."""
    texts = {
        "rig.toml": BASE, "forced.toml": FORCED, "free.toml": FREE, "study.toml": two_masses.TWO_SCENARIOS,
        "modes.csv": MODES_CSV, "modes.json": MODES_JSON, "frf.csv": FRF, "nonlinear.toml": NONLINEAR, "a.lvm": LVM,
        "xsens.csv": XSENS, "test.toml": MANIFEST,
    }  # fmt: skip
    unknowns = "m1=3,c1=20,c2=30"
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for name, text in texts.items():
            Path(name).write_text(text, encoding="utf-8")
        common = ["--set", unknowns, "--amplitude", "u=0.01", "--samples", "16", "--periods", "3", "-q"]
        for arguments in (
            ["simulate", "rig.toml", "-o", "records.csv", "--frequencies", "1:15/6", *common],
            ["simulate", "rig.toml", "-o", "amplitudes.csv", "--frequencies", "1:15/8", "--table", *common],
            ["simulate", "forced.toml", "-o", "forced.csv", "--frequencies", "1:15/8", "--table", "-q"],
            ["identify", "rig.toml", "amplitudes.csv", "--json", "estimate.json", "-q"],
        ):
            with contextlib.redirect_stderr(io.StringIO()) as told:
                if run(arguments) != 0:
                    raise RuntimeError(f"the corpus cannot be made: {arguments}: {told.getvalue()}")
        _write_binary()
        return {name: Path(name).read_bytes() for name in sorted(os.listdir())}


@cache
def attacks() -> dict[str, bytes]:
    """Well-formed files made to harm who reads them, by their names."""
    made = {
        "walk.toml": b'folder = "/"\n[[files]]\nname = "**/none.csv"\n',
        "up.toml": b'[[files]]\nname = "../../etc/passwd"\n',
        "secret.toml": b'[[files]]\nname = "/etc/passwd"\n',
        "title.toml": BASE.replace("Two", r"\u001b[31m\u202e\ufffe\n    -1\n").encode(),
        "formula.toml": BASE.replace("x1", "=1+x1").encode(),
        "quote.toml": BASE.replace('"x1"', "'x\"1'").replace("\nx1 ", "\n'x\"1' ").encode(),
        "noise.toml": BASE.replace("unit = ", "noise = 1e200, unit = ").encode(),
        "long.npy": b"\x93NUMPY\x01\x00v\x00"
        + b"{'descr': '<f8', 'fortran_order': False, 'shape': (1099511627776,), }".ljust(117) + b"\n",
        "step.uff": files()["modes.uff"].replace(b" 1.00000e+00", b"1.0000e-320"),
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        for k, attack in enumerate(ATTACKS):
            for suffix in (".h5", ".mat"):
                path = Path(folder, f"attack{k}{suffix}")
                write_hdf5(path, attack)
                made[path.name] = path.read_bytes()
        path = Path(folder, "corner.xlsx")
        book = openpyxl.Workbook()
        for row in (["time_s", "x1", "x2", "u"], *([k / 128, 1.0, 2.0, 3.0] for k in range(32))):
            book.active.append(row)
        book.active["XFD1048576"] = 1.0
        book.save(path)
        made[path.name] = path.read_bytes()
    return made


def _write_binary() -> None:
    """The recordings of the readers' tests in every format, and modes of a universal file."""
    records = recording(32)
    for label, (suffix, write) in WRITERS.items():
        if suffix != ".csv":
            write(Path(f"{label.lower().replace(', ', '_').replace(' ', '_')}{suffix}"), records)
    Path("dwell_2Hz.raw").write_bytes(dwell(records[0]))
    Path("recording.wav").write_bytes(wav(records[0].values * 1e3))
    shapes = np.array([[1, 0, 0], [0.6 - 0.01j, 0, 0]])
    write_universal_file(
        "modes.uff", (), [NodalMode(-2 + 24j, (1, 2), shapes), NodalMode(-9 + 65j, (1, 2), shapes)]
    )
