"""README, manual and examples: commands and programs run as printed, references are complete, links lead somewhere."""

import dataclasses
import re
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import dashpot
from dashpot.app.commands import COMMANDS
from dashpot.model.nonlinear.force_law import DAMPER_LAWS, SPRING_LAWS
from dashpot.model.rigfile import schema
from tests import documents
from tests.documents import ROOT, is_long, is_run, name_of, pages

RUN = [page for page in pages() if is_run(page)]


@pytest.fixture(autouse=True)
def as_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """80 columns, no colour, pictures into files."""
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("MPLBACKEND", "Agg")


@pytest.mark.slow
@pytest.mark.parametrize("page", [pytest.param(p, id=name_of(p)) for p in RUN if not is_long(p)])
def test_pages_do_what_they_print(page: Path, tmp_path: Path) -> None:
    documents.run_page(page, tmp_path)


@pytest.mark.long
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("page", [pytest.param(p, id=name_of(p)) for p in RUN if is_long(p)])
def test_long_pages_do_what_they_print(page: Path, tmp_path: Path) -> None:
    documents.run_page(page, tmp_path)


def test_readme_and_tutorial_are_run_every_time() -> None:
    quick = {name_of(page) for page in RUN if not is_long(page)}
    assert quick >= {"README.md", "docs/tutorial.md"}


def test_commands_that_are_not_run_are_called_console() -> None:
    for page in pages():
        for block in documents.blocks(page):
            commands = re.search(r"^(dashpot|python) ", block.text, re.MULTILINE)
            assert not commands or block.language in ("sh", "console", "python"), (
                f"{name_of(page)}:{block.line}: commands in a block of {block.language or 'no language'}"
            )


def test_links_between_files_lead_somewhere() -> None:
    """In README and examples, which the site does not check as they stand."""
    for page in [ROOT / "README.md", *sorted((ROOT / "examples").rglob("README.md"))]:
        for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text(encoding="utf-8")):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{name_of(page)}: {target}"


def test_every_example_has_its_number_and_its_place_in_the_index() -> None:
    index = (ROOT / "examples" / "README.md").read_text(encoding="utf-8")
    folders = sorted(path.name for path in (ROOT / "examples").iterdir() if path.is_dir())
    assert [name[:2] for name in folders] == [f"{k:02d}" for k in range(1, len(folders) + 1)]
    assert re.findall(r"\((\d\d_\w+)/README\.md\)", index) == folders


def test_the_reference_of_rig_files_names_every_key_and_law() -> None:
    text = (ROOT / "docs" / "reference" / "rigfile.md").read_text(encoding="utf-8")
    entries = [schema.Head, schema.InputEntry, schema.BlockEntry, schema.ElementEntry]
    entries += [schema.ConstantEntry, schema.ChannelEntry]
    for entry in entries:
        for key in entry.model_fields:
            assert f"`{key}`" in text, key
    for section in schema.TABLES:
        assert f"[{section}]" in text, section
    for law in {*SPRING_LAWS, *DAMPER_LAWS}:
        assert f'`"{law}"`' in text, law


def test_options_that_are_named_exist() -> None:
    """In commands, of that command; in prose, of any, or of the programs of others that are named."""
    of = {}
    for name in COMMANDS:
        parameters = import_module(f"dashpot.app.commands.{name}").command.params
        of[name] = {option for p in parameters for option in (*p.opts, *p.secondary_opts)} | {"--help"}
    others = {
        "--version",
        "--serve",
        "--long",
        "--slow",
        "--older",
        "--nworkers",
        "--nthreads",
    }  # dashpot itself, dev.py, Dask
    every = others.union(*of.values())
    for page in [*pages(), ROOT / "examples" / "README.md"]:
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        text = re.sub(r"dev\.py bench [^`\n]*", "", text)  # whose options are those of the benchmark
        named = set(re.findall(r"(?<![\w-])--[a-z][\w-]*", text))
        assert named <= every, f"{name_of(page)}: {sorted(named - every)}"
        for name, rest in re.findall(r"\bdashpot (\w+)([^\n`]*)", text):
            for option in re.findall(r"(?<![\w-])--[a-z][\w-]*", rest if name in of else ""):
                assert option in of[name], f"{name_of(page)}: dashpot {name} {option}"


def test_the_noise_of_averaged_responses_is_what_the_recipe_says() -> None:
    """From the coherence: 20,000 estimates from 16 averages, whose sd is known to 0.5 %; seed fixed."""
    recipe = (ROOT / "docs" / "howto" / "frfs.md").read_text(encoding="utf-8")
    assert "sd = |H| √((1 − γ²)/(2 n γ²)) for each part" in recipe
    rng, n = np.random.default_rng(0), 16
    X, N = rng.standard_normal((2, 20000, n)) + 1j * rng.standard_normal((2, 20000, n))
    H = np.sum((X + 0.5 * N) * np.conj(X), axis=1) / np.sum(np.abs(X) ** 2, axis=1)
    coherence = 1 / (1 + 0.25)
    stated = np.sqrt((1 - coherence) / (2 * n * coherence))
    assert np.std(H.real) == pytest.approx(stated, rel=0.06)  # 1/n more, for the power of X is estimated
    assert np.std(H.imag) == pytest.approx(stated, rel=0.06)


def test_the_manual_has_a_section_for_every_command() -> None:
    text = (ROOT / "docs" / "reference" / "commands.md").read_text(encoding="utf-8")
    for name in COMMANDS:
        assert f"`{name}`" in text, name


def test_every_public_name_is_in_the_reference_of_the_api() -> None:
    pages = "".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs" / "api").glob("*.md"))
    listed = re.findall(r"auto(?:class|function):: dashpot\.(\w+)$", pages, re.MULTILINE)
    assert sorted(listed) == sorted(name for name in dashpot.__all__ if name != "__version__")


def test_every_field_of_a_public_class_is_described() -> None:
    """By its name in the docstring, which is what the reference of the API shows."""
    for name in dashpot.__all__:
        value = getattr(dashpot, name)
        if not dataclasses.is_dataclass(value):
            continue
        text = value.__doc__ or ""
        for field in dataclasses.fields(value):
            assert re.search(rf"\b{field.name}\b", text), f"{name}.{field.name}"
