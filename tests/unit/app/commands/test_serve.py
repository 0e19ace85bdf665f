"""dashpot serve: what it needs before it serves anything."""

import pytest

from dashpot.app.commands import serve
from tests.unit.app.conftest import Command


def test_without_its_extra_it_names_the_cure(dashpot: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serve, "find_spec", lambda _: None)
    done = dashpot("serve --no-browser")
    assert done.code == 2
    assert len(done.err) == 1
    assert ".[web]" in done.err[0]


@pytest.mark.parametrize("words", ["serve nowhere", "serve --port 70000", "serve --port x"])
def test_bad_usage_is_one_line(dashpot: Command, words: str) -> None:
    done = dashpot(words)
    assert (done.code, len(done.err)) == (2, 1)
