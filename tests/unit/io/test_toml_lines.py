"""Lines of keys, in every way in which TOML writes keys."""

import tomllib

import pytest

from dashpot.io.toml_document import Lines

TEXT = '''# a comment = 1
name = "a # b = [ {"   # k = 2
text = """
fake = 1
[fake]
""""
raw = \'\'\'
other = 2\'\'\'
coordinates = [
  "x1",  # first, ]
  'x2',
]
a.b . "c.d" = { e = 1, "f\\u0041" = [1,
  2] }
[springs]
k1 = { between = ["x1", "x2"], value = 4_600.0 }
"k 2".value = 3
  [springs.k3]
  value = 1979-05-27T07:32:00
[[many]]
x = 1
[[many]]
x = 2
[many.deep]
y = 1
'''


@pytest.mark.parametrize(
    ("path", "line"),
    [
        (("name",), 2),
        (("text",), 3),
        (("raw",), 7),
        (("coordinates",), 9),
        (("coordinates", 0), 10),
        (("coordinates", 1), 11),
        (("a",), 13),
        (("a", "b"), 13),
        (("a", "b", "c.d"), 13),
        (("a", "b", "c.d", "e"), 13),
        (("a", "b", "c.d", "fA"), 13),
        (("a", "b", "c.d", "fA", 1), 14),
        (("springs",), 15),
        (("springs", "k1"), 16),
        (("springs", "k1", "value"), 16),
        (("springs", "k1", "between", 1), 16),
        (("springs", "k 2"), 17),
        (("springs", "k 2", "value"), 17),
        (("springs", "k3"), 18),
        (("springs", "k3", "value"), 19),
        (("many", 0, "x"), 21),
        (("many", 1, "x"), 23),
        (("many", 1, "deep", "y"), 25),
        (("springs", "k1", "missing"), 16),
        (("springs", "k9"), 15),
    ],
)
def test_lines(path: tuple[str | int, ...], line: int) -> None:
    tomllib.loads(TEXT)
    assert Lines(TEXT).of(path) == line


def test_an_unknown_key_of_the_root_has_no_line() -> None:
    assert Lines(TEXT).of(("fake",)) is None
    assert Lines(TEXT).of(()) is None


def test_a_text_that_is_not_toml_gives_the_lines_until_there() -> None:
    lines = Lines("a = 1\nb = [1, 2\nc 3\nd = 4")
    assert lines.of(("a",)) == 1
    assert lines.of(("d",)) is None
