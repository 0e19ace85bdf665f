"""A new export is a writer and a line, for Python and the command alike; its names load neither NumPy nor a writer."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

from dashpot.app.cli import run
from dashpot.errors import UsageError
from dashpot.export import formats
from dashpot.export.formats import ExportFormat, ExportOptions, Written
from dashpot.export.identified_rig import IdentifiedRig
from dashpot.model.rigfile import parse_rig
from tests.unit.export.exported import TWO_MASSES


def write_values(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    """The values of the unknowns, one a line."""
    Path(path).write_text("".join(f"{value:g}\n" for value in rig.theta), encoding="utf-8")
    return Written((path,))


@pytest.fixture
def values_format(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("dashpot.export.values")
    module.write_values = write_values  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    line = ExportFormat("values", (".values",), "values.write_values")
    monkeypatch.setattr(formats, "FORMATS", (*formats.FORMATS, line))


@pytest.mark.usefixtures("values_format")
def test_a_new_export_is_a_writer_and_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("rig.toml").write_text(TWO_MASSES, encoding="utf-8")
    given = {"m1": 3.0, "m2": 2.7, "k2": 4600.0, "c1": 20.0, "c2": 30.0}
    rig = parse_rig(TWO_MASSES)
    assert rig.export("python.values", given) == ("python.values",)
    assert Path("python.values").read_text(encoding="utf-8").split() == [
        f"{given[name]:g}" for name in rig.model.unknown_names
    ]
    # The command's choices are made when its module is loaded: the usual one stands again after the test.
    command = "dashpot.app.commands.export"
    monkeypatch.setattr(command, import_module(command))
    monkeypatch.delitem(sys.modules, command)
    values = ",".join(f"{name}={value}" for name, value in given.items())
    assert run(["export", "rig.toml", "--set", values, "--to", "values", "-o", "command.values", "-q"]) == 0
    assert Path("command.values").read_bytes() == Path("python.values").read_bytes()
    with pytest.raises(UsageError, match="does not use frequencies"):
        rig.export("python.values", given, frequencies=[1.0])


def test_every_line_names_a_writer() -> None:
    for line in formats.FORMATS:
        module, _, function = line.writer.partition(".")
        assert callable(getattr(import_module(f"dashpot.export.{module}"), function))


def test_the_names_load_no_numpy() -> None:
    code = (
        "import sys; from dashpot.export.formats import contents; contents(); print('numpy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
