"""Every code that the package gives is explained, and nothing else is."""

import ast
from pathlib import Path

import pytest

from dashpot.data.conditioning.steadiness import UNSTEADY
from dashpot.present.words import REMEDIED, notice_guide

SOURCE = Path(__file__).parents[3] / "src" / "dashpot"
# Codes that are composed when they are given, and places that pass on the codes of others.
COMPOSED = {
    "study/montecarlo.py": {"damaged_blocks", "outdated_blocks"},
    "data/conditioning/lines.py": {row.code for row in UNSTEADY},
}
PASSED_ON = {"data/record.py", "estimate/assessment.py", "estimate/result.py"}


def given_codes() -> dict[str, set[str]]:
    """Codes in calls of Notice and of `notice` of a record, by module."""
    codes: dict[str, set[str]] = {}
    for path in SOURCE.rglob("*.py"):
        place = path.relative_to(SOURCE).as_posix()
        source = path.read_text(encoding="utf-8")
        if "Notice(" not in source and ".notice(" not in source:
            continue
        tree = ast.parse(source)
        constants = {
            target.id: node.value.value
            for node in tree.body
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call):
                continue
            of_record = getattr(node.func, "attr", None) == "notice" and len(node.args) == 2
            if getattr(node.func, "id", None) != "Notice" and not of_record:
                continue
            first = node.args[0] if node.args else next(k.value for k in node.keywords if k.arg == "code")
            texts = {leaf.value for leaf in ast.walk(first) if isinstance(leaf, ast.Constant)}
            if isinstance(first, ast.Name) and first.id in constants:
                texts = {constants[first.id]}
            if place in COMPOSED and isinstance(first, ast.Attribute | ast.JoinedStr | ast.BinOp):
                texts = set(COMPOSED[place])
            assert texts or place in PASSED_ON, f"{place}:{node.lineno}: a code that no test can read"
            codes.setdefault(place, set()).update(str(text) for text in texts)
    return codes


@pytest.mark.slow
def test_every_code_is_explained_and_every_explanation_is_of_a_code() -> None:
    given = set().union(*given_codes().values())
    assert len(given) > 40
    assert given - set(notice_guide()) == set()
    assert set(notice_guide()) - given == set()


def test_explanations_are_sentences() -> None:
    for code, entry in notice_guide().items():
        for text in (entry.meaning, entry.cure):
            assert text[0].isupper() or text[0] == "`", code
            assert text.endswith("."), code
    headings = [entry.sees for entry in notice_guide().values()]
    assert len({heading.lower() for heading in headings}) == len(headings)  # each is found by itself
    assert not [each for each in headings if each.endswith(".") or not (each[0].isupper() or each[0] in "`±")]
    assert REMEDIED in notice_guide()
