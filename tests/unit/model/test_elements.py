"""A new kind of element is its name and its law, in one module."""

import subprocess
import sys

import pytest

PROGRAM = """
import importlib.util, sys
from pathlib import Path
path = Path(importlib.util.find_spec("dashpot.model").submodule_search_locations[0]) / "elements.py"
source = path.read_text(encoding="utf-8")
for old, new in (
    ('    HYSTERETIC = "hysteretic"\\n', '    RUBBER = "rubber"\\n'),
    ('_DECLARED: Mapping[Kind, tuple[str, Law]] = {\\n', '    Kind.RUBBER: ("rubbers", Law(0, "K", "stiffness")),\\n'),
):
    assert source.count(old) == 1
    source = source.replace(old, old + new)
module = importlib.util.module_from_spec(importlib.util.spec_from_loader("dashpot.model.elements", None))
sys.modules["dashpot.model.elements"] = module
exec(compile(source, str(path), "exec"), module.__dict__)

import pytest
import dashpot

rig = dashpot.parse_rig('''
coordinates = ["x"]
inputs = { u = {} }
channels = { x = { of = "x", relative_noise = 0.01 }, u = { of = "u" } }
[masses]
m = { at = "x", value = 2 }
[rubbers]
r = { between = ["x", "u"] }
[dampers]
c = { between = ["x", "u"] }
''')
assert [unknown.unit for unknown in rig.model.unknowns] == ["N/m", "N·s/m"]
assert rig.check().identifiable
estimate = rig.identify(rig.simulate({"r": 4000.0, "c": 20.0}, "2:14:3", seed=1))
assert abs(estimate["r"].value - 4000) < 5 * estimate["r"].sd
assert dashpot.parse_rig(dashpot.write_rig(rig)).model.elements == rig.model.elements
assert "r = ?" in rig.draw().svg()
"""


@pytest.mark.slow
def test_a_new_kind_is_a_name_and_a_law() -> None:
    """It is read, written, checked, simulated, identified and drawn; no other module knows it."""
    ran = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
