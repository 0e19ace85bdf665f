"""A session of the page on disk: rig with its history, data, results and what they were made of.  No server in it.

FOLDER/.dashpot/ID/          ID: the beginning of a hash of the session's token, so that nobody guesses its name
    session.json             what is there; written at every change, so that nothing is lost with the server
    history.json             every text that the rig file had
    rig.toml, data/…         as the engine reads them
    results/1/…              estimate, figures, report
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
import shutil
import unicodedata
from collections.abc import Mapping, Sequence
from pathlib import Path
from threading import RLock, Thread
from typing import Any

from dashpot.app.serve.engine import KEPT, PRIVATE, SCRATCH
from dashpot.app.serve.jobs import Engine, Failure, Job
from dashpot.errors import DashpotError, UsageError, printable
from dashpot.io.atomic import write_text

PARTS = ("files", "start", "rig", "channels", "work", "result", "plan", "live", "alarm")
STREAM = "sent: "  # before the names of what recorders send
KINDS = {"identify": "result", "design": "plan", "watch": "live"}  # what calls of the engine leave
MOST_RIG = 1 << 20  # bytes of a rig file: one of 10 000 elements has half of it
LONGEST = 120  # characters of a file's name; systems allow 255 bytes
RESERVED = re.compile(
    r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE
)  # names that Windows keeps for devices


def safe_name(name: str, otherwise: str = "data") -> str:
    """A file's name of what a browser sends: no folders, nothing hidden or unseen, nothing that a system keeps."""
    last = re.split(r"[/\\]", unicodedata.normalize("NFC", name))[-1]
    kept = "".join(c for c in last if unicodedata.category(c)[0] != "C" and c not in '<>:"|?*').strip(" .")
    if not kept or RESERVED.match(kept):
        kept = f"{otherwise}-{kept}".rstrip("-")
    stem, dot, end = kept.rpartition(".")
    if len(kept.encode()) > LONGEST:
        end = end if dot and len(end) <= 10 else ""
        kept = (stem or kept).encode()[: LONGEST - 12].decode(errors="ignore") + (f".{end}" if end else "")
    return kept


def new_token() -> str:
    """A token that nobody guesses, fit for an address."""
    return secrets.token_urlsafe(24)


def name_of(token: str) -> str:
    """The name of the folder of the session with that token."""
    return hashlib.sha256(token.encode()).hexdigest()[:24]


class Session:
    """What one person works on, in any number of tabs; every change counts up the `revisions` of what it concerns."""

    def __init__(self, folder: Path, served: Path, engine: Engine) -> None:
        self.folder, self.served, self.engine = folder, served, engine
        self.lock = RLock()
        self.revisions = dict.fromkeys(PARTS, 0)
        self.job: Job | None = None
        self.rig: dict[str, Any] | None = None  # what the engine says of the rig; None: it cannot be read
        self.problems: Sequence[Mapping[str, Any]] = ()  # why it cannot
        self.seen: dict[str, Any] | None = None  # what the engine says of the data
        self.looking, self._wanted = False, 0
        self.start: dict[str, Any] | None = None  # questions of the form for a first rig
        self.state: dict[str, Any] = {
            "rig": None,
            "beside": None,
            "at": -1,
            "data": [],
            "errors": [],
            "answers": {},
            "limits": {},
            "options": {},
            "job": None,
            **dict.fromkeys(KINDS.values()),
        }
        self.history: list[str] = []
        self.result: dict[str, Any] | None = None
        self.plan: dict[str, Any] | None = None
        self.live: dict[str, Any] | None = None  # what a test that still runs has shown so far
        shutil.rmtree(folder / SCRATCH, ignore_errors=True)
        for made in (folder, folder / "data", folder / "live", folder / "results"):
            made.mkdir(mode=0o700, exist_ok=True)
        self._load()

    # On disk.

    def _load(self) -> None:
        """What a former server has left; a job that it left undone is begun again, once."""
        kept = self.folder / "session.json"
        if not kept.exists():
            return
        try:
            self.state |= json.loads(kept.read_text(encoding="utf-8"))
            self.history = json.loads((self.folder / "history.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            self.state["errors"] = [
                {
                    "id": 0,
                    "text": f"{kept}: the session cannot be read and begins anew; remove it",
                    "line": None,
                }
            ]
            return
        uploaded = {each["path"] for each in self.state["data"]}
        for place in (self.folder / "data").iterdir():  # what broke off with that server
            if str(place.relative_to(self.folder)) not in uploaded:
                place.unlink()
        self.result, self.plan, self.live = (self._kept(self.state[name]) for name in KINDS.values())
        self.look()
        job = self.state["job"]
        if job is not None:
            self.state["job"] = None
            if not job.get("again"):
                self._begin({**job, "again": True})
            else:
                self.complain(
                    ["The computation was interrupted twice by the end of the server; start it again."]
                )

    def _kept(self, entry: Mapping[str, Any] | None) -> dict[str, Any] | None:
        if entry is None:
            return None
        try:
            content = json.loads((self.folder / entry["folder"] / KEPT).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return content if isinstance(content, dict) else None

    def _changed(self, *parts: str, texts: bool = False) -> None:
        """Keep the state, and let all pages know."""
        with self.lock:
            if texts:
                write_text(self.folder / "history.json", json.dumps(self.history))
            write_text(self.folder / "session.json", json.dumps(self.state))
            for part in parts:
                self.revisions[part] += 1

    # Errors stay until somebody closes them.

    def complain(self, texts: Sequence[str], lines: Sequence[int | None] = ()) -> None:
        """Add errors."""
        with self.lock:
            errors = self.state["errors"]
            for i, text in enumerate(texts):
                number = 1 + max((error["id"] for error in errors), default=0)
                if all(error["text"] != text for error in errors):
                    errors.append(
                        {"id": number, "text": printable(text), "line": lines[i] if lines else None}
                    )
            del errors[:-20]
        self._changed("work")

    def close_error(self, number: int) -> None:
        """Take an error away."""
        with self.lock:
            self.state["errors"] = [error for error in self.state["errors"] if error["id"] != number]
        self._changed("work")

    def _failed(self, failure: Failure) -> None:
        problems = failure.problems
        self.complain([p["text"] for p in problems], [p.get("line") for p in problems])

    # The rig file: each change is one edit of its text.

    @property
    def text(self) -> str:
        """The rig file as it is; empty where there is none."""
        at = self.state["at"]
        return self.history[at] if 0 <= at < len(self.history) else ""

    @property
    def can_undo(self) -> bool:
        """Whether there is an earlier text."""
        return bool(self.state["at"] > 0)

    @property
    def can_redo(self) -> bool:
        """Whether there is a later text."""
        return bool(self.state["at"] < len(self.history) - 1)

    def put_rig(self, name: str, text: str, beside: Path | None = None) -> None:
        """A rig file in place of the one that is there; undo brings that back.

        beside  the folder from which it came, where the files that it names are found
        """
        with self.lock:
            self.state["beside"] = None if beside is None else str(beside)
            self.state["rig"] = str(Path(safe_name(name, "rig")).with_suffix(".toml"))
            self.start = None
        self.write(text)

    def write(self, text: str) -> None:
        """The rig file's text, as somebody has changed it."""
        if len(text.encode(errors="replace")) > MOST_RIG:
            self.complain([f"A rig file may have {MOST_RIG >> 20} MB at most."])
            return
        with self.lock:
            if text == self.text:
                return
            self.state["rig"] = self.state["rig"] or "rig.toml"
            # 500 texts of the rig file are kept.
            self.history = [*self.history[: self.state["at"] + 1], text][-500:]
            self.state["at"] = len(self.history) - 1
        self._rewritten()

    def step(self, by: int) -> None:
        """Undo (−1) or redo (1)."""
        with self.lock:
            at = self.state["at"] + by
            if not 0 <= at < len(self.history):
                return
            self.state["at"] = at
        self._rewritten()

    def _rewritten(self) -> None:
        with self.lock:
            write_text(self.folder / self.state["rig"], self.text)
        self._changed("files", "rig", "result", "plan", texts=True)
        self.look()

    def change(self, change: Mapping[str, Any]) -> bool:
        """One change of the rig by its form, as the engine's call "edit" takes it; whether it was taken."""
        answer, failure = self.engine.ask(
            self._call("edit", text=self.text, rig=self.state["rig"], change=dict(change))
        )
        if failure is not None:
            self._failed(failure)
            return False
        self.write(answer["text"])
        return True

    def apply(self, cause: int) -> None:
        """Correct the rig file by a cause of the last result, and identify again."""
        if self.result is None or self.is_stale("rig"):
            self.complain(["The rig file has changed since this result was computed: press Identify first."])
            return
        self.write(self.result["causes"][cause]["text_after"])
        self.identify()

    # Data.

    def data_place(self, name: str) -> Path:
        """Where an uploaded file of that name goes: its own name, or one with a number where that is taken."""
        safe = Path(safe_name(name))
        with self.lock:
            names, n = [safe, *(safe.with_stem(f"{safe.stem}-{n}") for n in range(2, 1000))], 0
            while (self.folder / "data" / names[n]).exists():
                n += 1
            place = self.folder / "data" / names[n]
            place.touch(mode=0o600)  # nobody else takes it
        return place

    def add_data(self, place: Path, sha256: str = "") -> None:
        """A data file, uploaded or in the folder that is served; it is added to those that are there."""
        path = str(place.relative_to(self.folder)) if place.is_relative_to(self.folder) else str(place)
        with self.lock:
            entry = {"name": place.name, "path": path, "sha256": sha256, **_state_of(place)}
            self.state["data"] = [*(each for each in self.state["data"] if each["path"] != path), entry]
        self._changed("files", "result", "plan")
        self.look()

    def remove_data(self, path: str) -> None:
        """Take a data file away; one that was uploaded is deleted."""
        with self.lock:
            self.state["data"] = [each for each in self.state["data"] if each["path"] != path]
            if not os.path.isabs(path):
                (self.folder / path).unlink(missing_ok=True)
        self._changed("files", "result", "plan")
        self.look()

    @property
    def data(self) -> list[str]:
        """The data files, as the engine finds them, but for records at rest."""
        return [each["path"] for each in self.state["data"] if not each.get("rest")]

    @property
    def rest(self) -> list[str]:
        """Records at rest, from which the noise is taken."""
        return [each["path"] for each in self.state["data"] if each.get("rest")]

    def set_rest(self, path: str, rest: bool) -> None:
        """Say whether a file is a record at rest."""
        with self.lock:
            self.state["data"] = [
                {**each, "rest": rest} if each["path"] == path else each for each in self.state["data"]
            ]
        self._changed("files", "result", "plan")
        self.look()

    def choose(self, name: str, value: str) -> None:
        """An option of identify: method, band or within."""
        with self.lock:
            self.state["options"] = {**self.state["options"], name: value.strip()}
        self._changed("result")

    def in_folder(self, folders_too: bool = False) -> list[str]:
        """Files of the served folder that may be opened, by their paths in it."""
        found = ["."] if folders_too else []
        if folders_too:
            found += [f"{STREAM}{path.name}" for path in sorted((self.folder / "live").iterdir())]
        for folder, folders, files in os.walk(self.served):
            depth = len(Path(folder).relative_to(self.served).parts)
            folders[:] = sorted(name for name in folders if not name.startswith(".") and depth < 2)
            found += [
                os.path.relpath(os.path.join(folder, name), self.served)
                for name in sorted(files)
                if not name.startswith(".")
            ]
            if folders_too:
                found += [os.path.relpath(os.path.join(folder, name), self.served) for name in folders]
            if len(found) > 500:
                break
        return found[:500]

    def open_in_folder(self, name: str) -> None:
        """Open a file of the served folder: a rig file becomes this session's rig, anything else is data."""
        place = Path(os.path.realpath(self.served / name))
        try:
            hidden = any(
                part.startswith(".") for part in place.relative_to(os.path.realpath(self.served)).parts
            )
        except ValueError:
            hidden = True
        if hidden or not place.is_file():
            self.complain([f"{printable(name)}: there is no such file in the folder that is served"])
            return
        if place.suffix.lower() == ".toml":
            text = place.read_bytes()[: MOST_RIG + 1].decode("utf-8", errors="replace")
            if re.search(r"^\s*(coordinates\s*=|\[(inputs|springs|masses)\b)", text, re.MULTILINE):
                self.put_rig(place.name, text, place.parent)
                return
        self.add_data(place)

    # What rig and data are: asked of the engine in the background, the newest question counts.

    def look(self) -> None:
        """See anew what the rig says, what the data hold, and what a first rig would be."""
        with self.lock:
            self._wanted += 1
            if self.looking:
                return
            self.looking = True
        Thread(target=self._look, daemon=True).start()

    def _look(self) -> None:
        while True:
            with self.lock:
                wanted, text, name, data = self._wanted, self.text, self.state["rig"], self.data
            rig, problems = None, tuple[dict[str, Any], ...]()
            if text:
                rig, failure = self.engine.ask(self._call("open", text=text, rig=name))
                problems = () if failure is None else failure.problems
                rig = rig if failure is None else None
            with self.lock:
                self.rig, self.problems = rig, problems
            self._changed("rig")
            seen: dict[str, Any] | None = None
            if data:
                seen, failure = self.engine.ask(self._call("inspect", text=text, rig=name, data=data))
                if failure is not None:
                    seen = {
                        "files": [],
                        "channels": [],
                        "plots": [],
                        "notes": [],
                        "problems": [each["text"] for each in failure.problems],
                    }
            if data and not text:
                self.ask_anew()
            with self.lock:
                self.seen = seen
                self.start = self.start if data and not text else None
                again = wanted != self._wanted
                self.looking = again
            self._changed("channels", "start")
            if not again:
                return

    def reply(self, key: str, answer: str) -> None:
        """An answer to a question of the form for a first rig; `ask_anew` shows what follows from it."""
        with self.lock:
            self.state["answers"] = {**self.state["answers"], key: answer}

    def ask_anew(self) -> None:
        """The form for a first rig with the answers so far, those that come while the engine works among them."""
        while True:
            asked = self.data, self.state["answers"]
            start, failure = self.engine.ask(self._call("start", data=asked[0], answers=asked[1]))
            with self.lock:
                if failure is not None:
                    start = {"text": "", "questions": [], **(self.start or {})}
                    start["problems"] = [each["text"] for each in failure.problems]
                if asked == (self.data, self.state["answers"]):
                    self.start = start
                    break
        self._changed("start")

    def answer(self, question: Mapping[str, Any]) -> str:
        """What has been answered to a question of the form, else what the engine takes; empty where it is no choice."""
        said = str(self.state["answers"].get(question["key"]) or question["answer"] or "")
        return said if said in question.get("choices", (said,)) else ""

    def take_first_rig(self) -> None:
        """The rig that the form describes becomes the rig file."""
        self.ask_anew()
        start = self.start or {"text": ""}
        if start.get("problems"):
            self.complain(start["problems"])
        elif start["text"]:
            self.put_rig("rig.toml", start["text"])

    # Jobs: one at a time.

    def _call(self, call: str, **more: Any) -> dict[str, Any]:
        places = {"folder": str(self.folder), "reads": [str(self.served)], "beside": self.state["beside"]}
        return {"call": call, **places, **more}

    def stamp(self) -> dict[str, Any]:
        """What a result is made of: checksums of the rig's text, and what tells every data file from another."""
        files = []
        for each in self.state["data"]:
            place = self.folder / each["path"]
            files.append([each["path"], each["sha256"], each.get("rest", False), *_state_of(place).values()])
        options = {name: value for name, value in self.state["options"].items() if value}
        return {"rig": hashlib.sha256(self.text.encode()).hexdigest(), "data": files, "options": options}

    def made_of(self) -> str:
        """What the last result was made of: names, and the beginnings of checksums or the sizes."""
        made = self.state["result"]["made"]
        files = [
            f"{os.path.basename(path)} ({sha256[:8] or f'{size} bytes'})"
            for path, sha256, _, size, _ in made["data"]
        ]
        options = [f"{name} {value}" for name, value in made["options"].items()]
        return ", ".join([f"{self.state['rig']} ({made['rig'][:8]})", *files, *options])

    def is_stale(self, part: str | None = None, of: str = "result") -> bool:
        """Whether rig, data or options (or that one alone) differ from those that the last result, or plan, had."""
        kept = self.state[of]
        if kept is None:
            return False
        now = self.stamp()
        return any(kept["made"].get(name) != now[name] for name in ((part,) if part else now))

    def identify(self) -> None:
        """Estimate the unknowns of the rig from the data."""
        if not self.text or not self.data:
            self.complain(["Give a rig file and data files first."])
            return
        self._begin({"call": "identify", "options": self.state["options"], "rest": self.rest})

    def design(self, options: Mapping[str, str]) -> None:
        """Design the next test within the limits of the shaker."""
        with self.lock:
            self.state["limits"] = dict(options)
        band = self.state["options"].get("band", "")
        self._begin({"call": "design", "options": {**options, "record-band": band}, "rest": self.rest})

    def watch(self, name: str, target: str, options: Mapping[str, str]) -> None:
        """Follow a test that still runs: a file of the served folder that grows, or a folder of it that fills."""
        streamed = name.startswith(STREAM)
        root = self.folder / "live" if streamed else self.served
        place = Path(os.path.realpath(root / name.removeprefix(STREAM)))
        if not self.text:
            self.complain(["Give a rig file first: a live test needs to know what is unknown."])
        elif not place.is_relative_to(os.path.realpath(root)) or not place.exists():
            self.complain(
                [f"{printable(name)}: there is no such file or folder in the folder that is served"]
            )
        else:
            self.live = None
            read = {"band": self.state["options"].get("band", ""), "rest": self.rest}
            wanted = {"source": str(place), "target": target, "options": dict(options)}
            self._begin({"call": "watch", **wanted, **read})

    def live_place(self, name: str) -> Path:
        """Where what a recorder sends under that name is kept: a live test follows it."""
        return self.folder / "live" / safe_name(name, "stream")

    def export(self, end: str) -> None:
        """Write the rig with its last estimate for another program, next to the estimate."""
        kept = self.state["result"]
        if kept is None:
            self.complain(["There is no estimate yet: press Identify first."])
            return
        call = {"call": "export", "name": f"rig.{end}", "estimate": f"{kept['folder']}/estimate.json"}
        self._begin({**call, "out": kept["folder"]})

    def cancel(self) -> None:
        """End the job under way."""
        with self.lock:
            if self.job is not None:
                self.job.cancel()

    def _begin(self, wanted: Mapping[str, Any]) -> None:
        with self.lock:
            if self.job is not None:
                self.complain(["One computation at a time: wait for the present one, or cancel it."])
                return
            self.job = Job(wanted["call"])
            self.state["job"] = dict(wanted)
            numbers = [int(path.name) for path in (self.folder / "results").iterdir() if path.name.isdigit()]
            out = wanted.get("out") or f"results/{max(numbers, default=0) + 1}"
            kept = {self.state[name]["folder"] for name in KINDS.values() if self.state[name] is not None}
            for number in sorted(numbers)[:-10]:  # whose files are kept as well as those that are shown
                if f"results/{number}" not in kept:
                    shutil.rmtree(self.folder / "results" / str(number), ignore_errors=True)
            (self.folder / out).mkdir(exist_ok=True)
            call = self._call(rig=self.state["rig"], data=self.data, **{**wanted, "out": out})
            made = self.stamp()
        self._changed("work")
        Thread(target=self._work, args=(self.job, call, made), daemon=True).start()

    def _work(self, job: Job, call: dict[str, Any], made: dict[str, Any]) -> None:
        kind = KINDS.get(job.call)

        def hears(event: Mapping[str, Any]) -> None:
            if "progress" in event:
                job.moved(*event["progress"])
            elif kind is not None:
                write_text(self.folder / call["out"] / KEPT, json.dumps(event["result"]))
                with self.lock:
                    setattr(self, kind, event["result"])
                    self.state[kind] = {"folder": call["out"], "made": made}
                self._changed(kind, "alarm")

        try:
            failure = self.engine.run(call, hears, job)
        except DashpotError as error:
            failure = Failure(tuple({"text": str(each), "line": None} for each in error.problems))
        with self.lock:
            self.job, self.state["job"] = None, None
        if failure is not None and not job.cancelled:
            self._failed(failure)
        if job.call == "export" and failure is None and self.result is not None:
            names = {*self.result["files"], call["name"]}
            self.result = {**self.result, "files": sorted(names)}
            write_text(self.folder / call["out"] / KEPT, json.dumps(self.result))
        self._changed("work", "result", "plan", "live", "alarm")

    def download(self, name: str) -> Path | None:
        """The file of that name among the rig file and the results; None for any other name."""
        if self.text and name == self.state["rig"]:
            return self.folder / name
        for kept in ("result", "plan"):
            entry = self.state[kept]
            content = getattr(self, kept)
            if entry is not None and content is not None and name in content["files"]:
                return self.folder / entry["folder"] / name
        return None


def _state_of(place: Path) -> dict[str, int]:
    try:
        status = place.stat()
    except OSError:
        return {"size": 0, "changed": 0}
    return {"size": status.st_size, "changed": status.st_mtime_ns}


class Sessions:
    """All sessions of a served folder, by their tokens."""

    def __init__(self, served: Path, engine: Engine) -> None:
        self.served, self.engine = served, engine
        self.root = served / PRIVATE
        self._open: dict[str, Session] = {}
        self._lock = RLock()
        try:
            self.root.mkdir(mode=0o700, exist_ok=True)
        except OSError as error:
            cure = "name a folder in which you may write"
            raise UsageError(f"sessions cannot be kept here ({error.strerror})", str(served), cure) from None

    def first(self) -> str:
        """The token of the session that the address on the terminal leads to: the same whenever a folder is served."""
        place = self.root / "token"
        try:
            token = place.read_text(encoding="ascii").strip()
        except (OSError, ValueError):
            token = ""
        if not re.fullmatch(r"[\w-]{32}", token) or not (self.root / name_of(token)).is_dir():
            token = self.new()
            with open(os.open(place, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as file:
                file.write(token)
        return token

    def new(self) -> str:
        """The token of a new session."""
        token = new_token()
        with self._lock:
            (self.root / name_of(token)).mkdir(mode=0o700)
        return token

    def of(self, token: str | None) -> Session | None:
        """The session of a token; None if it is none."""
        if not token or not re.fullmatch(r"[\w-]{32}", token):
            return None
        name = name_of(token)
        with self._lock:
            if name not in self._open:
                if not (self.root / name).is_dir():
                    return None
                self._open[name] = Session(self.root / name, self.served, self.engine)
            return self._open[name]
