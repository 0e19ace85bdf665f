"""Sessions on disk: every change is kept, can be undone, and marks results that it makes old."""

import json
from pathlib import Path
from typing import Any

import pytest

from dashpot.app.serve.session import Session, Sessions

FIRST, SECOND = 'coordinates = ["x"]\n', 'coordinates = ["y"]\n'


class Answers:
    """An engine that answers at once; identify gives one cause with its text."""

    def ask(self, call: Any) -> tuple[dict[str, Any], None]:
        return {}, None

    def run(self, call: Any, hears: Any, job: Any = None) -> None:
        hears({"result": {"causes": [{"text_after": SECOND}], "files": [], "plan": {}}})


@pytest.fixture
def sessions(tmp_path: Path) -> Sessions:
    return Sessions(tmp_path, Answers())  # type: ignore[arg-type]


@pytest.fixture
def session(sessions: Sessions) -> Session:
    found = sessions.of(sessions.first())
    assert found is not None
    return found


def with_result(session: Session) -> None:
    place = session.data_place("run.csv")
    place.write_text("1")
    session.add_data(place)
    session.put_rig("rig.toml", FIRST)
    session._work(session_job(), session._call("identify", out="results"), session.stamp())


def session_job() -> Any:
    from dashpot.app.serve.jobs import Job

    return Job("identify")


def test_every_text_can_be_undone_and_redone(session: Session) -> None:
    session.put_rig("rig.toml", FIRST)
    session.write(SECOND)
    session.step(-1)
    assert (session.text, session.can_undo, session.can_redo) == (FIRST, False, True)
    session.step(1)
    assert session.text == SECOND
    assert (session.folder / "rig.toml").read_text() == SECOND


def test_another_server_finds_the_session_as_it_was(
    session: Session, sessions: Sessions, tmp_path: Path
) -> None:
    with_result(session)
    session.complain(["something is wrong"])
    session.write(SECOND)
    session.data_place("cut off.csv")  # of an upload that ended with the server
    again = Sessions(tmp_path, Answers())  # type: ignore[arg-type]
    assert again.first() == sessions.first()
    found = again.of(again.first())
    assert found is not None
    assert (found.text, found.data, found.result) == (SECOND, session.data, session.result)
    assert [error["text"] for error in found.state["errors"]] == ["something is wrong"]
    assert [path.name for path in (found.folder / "data").iterdir()] == ["run.csv"]
    assert found.is_stale()
    found.step(-1)
    assert not found.is_stale()


def test_a_result_is_stale_where_rig_or_data_change(session: Session) -> None:
    with_result(session)
    assert not session.is_stale()
    (session.folder / session.data[0]).write_text("another")
    assert session.is_stale("data")
    assert not session.is_stale("rig")


def test_a_cause_is_applied_to_the_rig_that_it_was_found_for(session: Session) -> None:
    with_result(session)
    session.write(SECOND + "# changed\n")
    session.apply(0)
    assert session.text.endswith("# changed\n")
    session.step(-1)
    session.apply(0)
    assert session.text == SECOND
    session.step(-1)
    assert session.text == FIRST


def test_errors_stay_until_they_are_closed(session: Session) -> None:
    session.complain(["one", "two\nlines"])
    assert [error["text"] for error in session.state["errors"]] == ["one", "two\\nlines"]
    session.close_error(session.state["errors"][0]["id"])
    kept = json.loads((session.folder / "session.json").read_text())
    assert [error["text"] for error in kept["errors"]] == ["two\\nlines"]


@pytest.mark.parametrize("name", ["../secret.csv", "/etc/passwd", ".dashpot/token", "none.csv"])
def test_only_files_of_the_folder_are_opened(session: Session, tmp_path: Path, name: str) -> None:
    session.open_in_folder(name)
    assert session.data == []
    assert len(session.state["errors"]) == 1


def test_a_second_computation_is_refused_while_one_is_under_way(session: Session) -> None:
    session.job = session_job()
    session.design({})
    assert len(session.state["errors"]) == 1


def test_the_next_test_takes_band_and_rest_of_identify_and_a_rig_its_folder(session: Session) -> None:
    calls: list[Any] = []
    session.engine.run = lambda call, hears, job=None: calls.append(call)  # type: ignore[method-assign, assignment, return-value]
    (session.served / "sub").mkdir()
    (session.served / "sub" / "rig.toml").write_text('coordinates = ["x"]\n', encoding="utf-8")
    session.open_in_folder("sub/rig.toml")
    for name in ("run.csv", "still.csv"):
        session.add_data(session.data_place(name))
    session.set_rest("data/still.csv", True)
    session.choose("band", "2:150")
    session.design({"samples": "100"})
    while session.job is not None:
        pass
    call = calls[-1]
    assert (call["options"]["record-band"], call["rest"]) == ("2:150", ["data/still.csv"])
    assert (call["data"], call["beside"]) == (["data/run.csv"], str(session.served / "sub"))


def test_an_answer_given_while_the_form_is_made_is_in_the_form(session: Session) -> None:
    asked: list[dict[str, str]] = []

    class Busy(Answers):
        def ask(self, call: Any) -> tuple[dict[str, Any], None]:
            asked.append(call["answers"])
            if len(asked) == 1:
                session.reply("mass", "3")
            question = {"key": "mass", "ask": "Mass", "answer": call["answers"].get("mass", "")}
            return {"text": f"{call['answers']}", "questions": [question]}, None

    session.engine = Busy()  # type: ignore[assignment]
    session.ask_anew()
    assert asked == [{}, {"mass": "3"}]
    assert session.start is not None
    assert "3" in session.start["text"]
    session.reply("mass", "4")  # shown before the engine has heard of it
    assert session.answer(session.start["questions"][0]) == "4"
    assert session.answer({"key": "mass", "answer": "", "choices": {"5": "5"}}) == ""
