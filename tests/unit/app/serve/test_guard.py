"""What the page's guard lets through: hosts, origins, tokens, uploads under limits, files of the results alone."""

import asyncio
import os
from pathlib import Path
from typing import Any

import pytest

from dashpot.app.serve import guard as module
from dashpot.app.serve.guard import Guard
from dashpot.app.serve.session import Sessions

OWN = "127.0.0.1:8420"
HOSTILE = [
    "../../evil.csv", "..\\..\\evil.csv", "/etc/passwd", "C:\\windows\\evil.csv", ".bashrc", "..", "", "con.csv",
    "a\0b.csv", "\u202ecsv.exe", "<img src=x onerror=alert(1)>.csv", "x" * 5000 + ".csv",
]  # fmt: skip


class NoEngine:
    """Answers nothing, so that no process is begun."""

    def ask(self, call: Any) -> tuple[dict[str, Any], None]:
        return {}, None


class Served:
    """A guard before a page that says which session it was given."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.sessions = Sessions(folder, NoEngine())  # type: ignore[arg-type]
        self.token = self.sessions.first()
        self.guard = Guard(self.page, self.sessions, ("127.0.0.1",), 8420)

    async def page(self, scope: Any, receive: Any, send: Any) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": scope[module.SESSION].folder.name.encode()})

    def ask(
        self, path: str, query: str = "", *, method: str = "GET", body: list[bytes] | None = None, whole: bool = True,
        **headers: str,
    ) -> tuple[int, bytes, dict[str, str]]:  # fmt: skip
        given = {"host": OWN, **{key.replace("_", "-"): value for key, value in headers.items()}}
        scope = {
            "type": "http", "method": method, "path": path, "query_string": query.encode(),
            "headers": [(key.encode(), value.encode()) for key, value in given.items()],
        }  # fmt: skip
        parts = body or [b""]
        coming: list[dict[str, Any]] = [
            {"type": "http.request", "body": part, "more_body": i + 1 < len(parts) or not whole}
            for i, part in enumerate(parts)
        ]
        coming.append({"type": "http.disconnect"})
        sent: list[dict[str, Any]] = []

        async def receive() -> dict[str, Any]:
            return coming.pop(0)

        async def send(message: Any) -> None:
            sent.append(message)

        asyncio.run(self.guard(scope, receive, send))
        told = {key.decode(): value.decode() for key, value in sent[0]["headers"]}
        return sent[0]["status"], b"".join(message.get("body", b"") for message in sent[1:]), told

    def upload(
        self, name: str, *body: bytes, kind: str = "data", **more: Any
    ) -> tuple[int, bytes, dict[str, str]]:
        from urllib.parse import quote

        query = f"kind={kind}&name={quote(name)}&token={self.token}"
        return self.ask("/upload", query, method="POST", body=[*body], **more)

    def files(self) -> set[Path]:
        """Files but those in which sessions are kept, which are written in the background."""
        own = self.folder / ".dashpot"
        return {
            path
            for path in self.folder.rglob("*")
            if path.is_file() and path.parent.parent != own and path.parent != own
        }


@pytest.fixture
def served(tmp_path: Path) -> Served:
    folder = tmp_path / "served"
    folder.mkdir()
    return Served(folder)


def test_the_token_opens_its_session_and_the_cookie_stands_for_it(served: Served) -> None:
    status, body, headers = served.ask("/", f"token={served.token}")
    assert status == 200
    cookie = headers["set-cookie"].partition(";")[0]
    assert served.ask("/", cookie=cookie)[:2] == (200, body)
    assert "'self'" in headers["content-security-policy"]


@pytest.mark.parametrize("token", ["", "x", "A" * 32, "../other", "%00"])
def test_nothing_is_served_without_the_token(served: Served, token: str) -> None:
    for path, method in (
        ("/", "GET"),
        ("/file/rig.toml", "GET"),
        ("/upload", "POST"),
        ("/new", "POST"),
        ("/_nicegui/x", "GET"),
    ):
        status, body, _ = served.ask(path, f"token={token}", method=method)
        assert status == 403
        assert body.count(b"\n") == 1


def test_a_cookie_alone_changes_nothing(served: Served) -> None:
    cookie = f"dashpot-8420={served.token}"
    for path in ("/upload", "/new"):
        assert served.ask(path, method="POST", cookie=cookie, body=[b"x"])[0] == 403


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:9999", "https://evil.example"]
)
def test_pages_of_others_are_not_answered(served: Served, origin: str) -> None:
    assert served.ask("/", f"token={served.token}", origin=origin)[0] == 403
    assert served.ask("/", f"token={served.token}", origin=f"http://{OWN}")[0] == 200


def test_a_name_that_somebody_points_here_is_not_answered(served: Served) -> None:
    assert served.ask("/", f"token={served.token}", host="evil.example:8420")[0] == 403


@pytest.mark.parametrize("name", HOSTILE)
def test_whatever_a_file_is_called_it_stays_in_the_session(served: Served, tmp_path: Path, name: str) -> None:
    before, outside = served.files(), {*tmp_path.iterdir()}
    assert served.upload(name, b"time_s,x\n0,1\n")[0] == 200
    (new,) = served.files() - before
    session = served.sessions.of(served.token)
    assert session is not None
    assert new.parent == session.folder / "data"
    assert new.name[0] not in ". "
    assert len(os.fsencode(new.name)) <= 130
    assert {*tmp_path.iterdir()} == outside


def test_two_files_of_one_name_stand_beside_each_other(served: Served) -> None:
    for text in (b"one", b"two"):
        assert served.upload("run.csv", text)[0] == 200
    session = served.sessions.of(served.token)
    assert session is not None
    assert [(session.folder / path).read_bytes() for path in session.data] == [b"one", b"two"]


def test_what_is_too_large_is_refused_at_once_and_leaves_nothing(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert served.upload("big.csv", content_length=str(2 << 30))[0] == 413
    monkeypatch.setattr(module, "MOST_UPLOAD", 100)
    assert served.upload("big.csv", *[b"x" * 60] * 2)[0] == 413
    assert served.upload("rig.toml", b"x" * (2 << 20), kind="rig")[0] == 413
    assert served.upload("cut.csv", b"x", whole=False)[0] == 400
    assert served.upload("empty.csv", b"")[0] == 400
    assert served.upload("rig.toml", b"\xff\xfe\x00", kind="rig")[0] == 400
    session = served.sessions.of(served.token)
    assert session is not None
    assert len(session.state["errors"]) == 6
    assert served.files() == set()


def test_sessions_see_nothing_of_each_other(served: Served) -> None:
    other = served.sessions.new()
    assert served.upload("rig.toml", b'coordinates = ["x"]', kind="rig")[0] == 200
    assert served.ask("/file/rig.toml", f"token={served.token}")[0] == 200
    assert served.ask("/file/rig.toml", f"token={other}")[0] == 404


@pytest.mark.parametrize(
    "name", ["session.json", "history.json", "../token", "..%2ftoken", "/etc/passwd", "data/run.csv"]
)
def test_results_alone_are_given_out(served: Served, name: str) -> None:
    assert served.upload("run.csv", b"secret")[0] == 200
    assert served.ask(f"/file/{name}", f"token={served.token}")[0] == 404


def test_what_a_recorder_sends_is_added_to_a_live_file(served: Served) -> None:
    query = f"name=../run.csv&token={served.token}"
    for parts in ([b"time_s,x\n", b"0,1\n"], [b"1,2\n"]):
        assert served.ask("/stream", query, method="PUT", body=parts)[0] == 200
    session = served.sessions.of(served.token)
    assert session is not None
    assert session.live_place("run.csv").read_bytes() == b"time_s,x\n0,1\n1,2\n"
    assert "sent: run.csv" in session.in_folder(folders_too=True)
    assert served.ask("/stream", "name=run.csv", method="PUT", body=[b"x"])[0] == 403
