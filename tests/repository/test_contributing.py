"""The skeletons of CONTRIBUTING.md work as they stand, each with the line that it asks for."""

import json
import re
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

import numpy as np
import pytest

import dashpot
from dashpot.check.explain import engine
from dashpot.data.readers import registry as readers
from dashpot.estimate import registry as methods
from tests.documents import ROOT
from tests.two_masses import RIG

TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


def skeleton(monkeypatch: pytest.MonkeyPatch, name: str) -> Any:
    """The module that a block of the page holds, as if it were saved where its first line says."""
    (block,) = [
        each for each in re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL) if f"/{name}.py\n" in each
    ]
    place = re.match(r"# src/(.*)\.py\n", block)
    assert place is not None
    module = ModuleType(place[1].replace("/", "."))
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(compile(block, place[0], "exec"), module.__dict__)
    return module


@pytest.fixture
def rig(tmp_path: Path) -> dashpot.Rig:
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    return dashpot.read_rig(tmp_path / "rig.toml")


def measured(rig: dashpot.Rig) -> Any:
    return dashpot.spectrum(rig.simulate({"m1": 3.0, "c1": 20.0, "c2": 30.0}, "1:15/8log", seed=1))


@pytest.mark.long
def test_an_effect_is_found(monkeypatch: pytest.MonkeyPatch, rig: dashpot.Rig) -> None:
    quarter = skeleton(monkeypatch, "quarter")
    # Beside a few others: with all of them, as the page says, it is found as well, in many times the time.
    few = [each for each in engine.KINDS if each[1].__name__ in ("sign", "delay", "conjugate")]
    monkeypatch.setattr(engine, "KINDS", (*few, (0.01, quarter.quarter)))
    good = measured(rig)
    late = good.amplitudes * np.where(np.arange(good.amplitudes.shape[-1]) == 0, -1j, 1.0)
    found = rig.identify(replace(good, amplitudes=late, moments=None)).assessment
    assert found is not None
    assert (found.findings[0].kind, found.findings[0].of) == ("quarter", (good.channels[0].name,))


@pytest.mark.long
def test_an_estimator_agrees_with_the_others(monkeypatch: pytest.MonkeyPatch, rig: dashpot.Rig) -> None:
    skeleton(monkeypatch, "output_error")
    known = MappingProxyType({**methods.METHODS, "oe": ("likelihood.output_error", "OutputError")})
    monkeypatch.setattr(methods, "METHODS", known)
    spectrum = measured(rig)
    ours, theirs = (dashpot.identify(rig.model, spectrum, name) for name in ("oe", "ml"))
    assert ours.status == "converged"
    assert np.all(np.abs(ours.values - theirs.values) < 0.1 * theirs.sd)
    np.testing.assert_allclose(ours.sd, theirs.sd, rtol=0.1)


def test_a_reader_reads_and_refuses(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    lists = skeleton(monkeypatch, "json_lists")
    reader = readers.Reader("JSON of lists", lists.read_lists, (b'{"lists"',))
    monkeypatch.setattr(readers, "READERS", (reader, *readers.READERS))
    path = tmp_path / "data.lists"
    path.write_text(json.dumps({"lists": {"time_s": [0, 0.1, 0.2], "x": [1, 2, 3]}}))
    (record,) = dashpot.read(path, [dashpot.Channel("x", {"x": 1})]).records
    assert record.values.tolist() == [[1], [2], [3]]
    path.write_text('{"lists": {"time_s": [0,')
    with pytest.raises(dashpot.DataError, match="damaged JSON"):
        dashpot.read(path, [dashpot.Channel("x", {"x": 1})])


def test_a_command_answers_and_refuses(
    monkeypatch: pytest.MonkeyPatch, rig: dashpot.Rig, tmp_path: Path
) -> None:
    from click.testing import CliRunner

    command = skeleton(monkeypatch, "weigh").command
    done = CliRunner().invoke(command, [str(tmp_path / "rig.toml")])
    assert (done.exit_code, done.output) == (0, "2.7 kg in 1 of 2 bodies\n")
    (tmp_path / "rig.toml").write_text(RIG.replace(", value = 2.7", ""), encoding="utf-8")
    refused = CliRunner().invoke(command, [str(tmp_path / "rig.toml")])
    assert isinstance(refused.exception, dashpot.UsageError)


def test_every_licence_that_is_named_is_here_and_the_version_is_one() -> None:
    reuse, project, kernels = (
        tomllib.loads((ROOT / name).read_text(encoding="utf-8"))
        for name in ("REUSE.toml", "pyproject.toml", "kernels/pyproject.toml")
    )
    for entry in reuse["annotations"]:
        assert (ROOT / "LICENSES" / f"{entry['SPDX-License-Identifier']}.txt").exists(), entry
        assert entry["path"] == "**" or (ROOT / entry["path"]).exists(), entry
    assert reuse["annotations"][0]["SPDX-License-Identifier"] == project["project"]["license"] == "MIT"
    assert kernels["project"]["license"] == "MIT"
    cited = re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    assert cited is not None
    version = project["project"]["version"]
    assert cited[1] == version
    recipe = (ROOT / "conda" / "meta.yaml").read_text(encoding="utf-8")
    assert f'version = "{version}"' in recipe
    for needed in project["project"]["dependencies"]:
        name, _, least = needed.partition(">=")
        assert re.search(rf"- {name}(-base)? >={re.escape(least)}$", recipe, re.MULTILINE), needed
    assert f"## [{version}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
