"""Names and values in messages."""

import tomllib

import pytest

from dashpot.io.words import choose_from, did_you_mean, quoted, shown, written


@pytest.mark.parametrize("text", ["x", 'a "b"', "tab\tand\nline", "\x7f\u2028", "\U000e0001", "µ·²"])
def test_a_quoted_text_is_one_line_of_toml_that_reads_back(text: str) -> None:
    assert quoted(text).isprintable()
    assert tomllib.loads(f"a = {quoted(text)}")["a"] == text


def test_values_as_a_file_writes_them() -> None:
    assert [written(value) for value in (True, 1.5, "x", {}, [], 10**30)] == [
        "true", "1.5", '"x"', "a table", "a list", "so large a number",
    ]  # fmt: skip
    assert len(written("x" * 1000)) == 42
    assert shown("x" * 100) == "x" * 40 + "…"


def test_what_is_nearly_a_known_name_is_suggested() -> None:
    assert did_you_mean("spirngs", ["springs", "masses"]) == 'did you mean "springs"? '
    assert did_you_mean("MAS", ["springs", "masses"]) == 'did you mean "masses"? '
    assert did_you_mean("zzz", ["springs"]) == ""


def test_the_known_names_are_offered_after_the_one_that_is_like_it() -> None:
    assert choose_from(["x1", "ground"]) == "choose from x1, ground"
    assert choose_from(["x1", "ground"], "Ground") == 'did you mean "ground"? If not, choose from x1, ground'
    assert choose_from([]) == "choose from none"
