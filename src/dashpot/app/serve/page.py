"""The page itself, in NiceGUI: what a session holds, shown and changed.  Nothing is computed here."""

from __future__ import annotations

import asyncio
import html
import json
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from fastapi import FastAPI
from nicegui import ui

from dashpot.app.serve.guard import MOST_UPLOAD, SESSION
from dashpot.app.serve.session import Session

STATIC = Path(__file__).with_name("static")
FIELDS = {"value": "Value", "sd": "± (sd)", "guess": "Guess"}
CHANNEL_FIELDS = {"of": "Point", "quantity": "Quantity", "unit": "Unit"}
QUANTITIES = ("displacement", "velocity", "acceleration", "force")
KINDS = {
    "masses": "Body",
    "springs": "Spring",
    "dampers": "Damper",
    "inerters": "Inerter",
    "channels": "Sensor",
}
LIMITS = {
    "time": ("Time for the test", "10min"),
    "samples": ("or samples", "2000"),
    "target": ("or target", "1%"),
    "rate": ("Sampling rate, Hz", "500"),
    "stroke": ("Stroke", "5mm"),
    "max-acceleration": ("Acceleration", "1gn"),
    "max-force": ("Force", "50N"),
}
# Seen while scripts and styles load, and of the page as it will be: its head and its first cards.
FIRST = (
    '<div id="first" aria-busy="true"><div class="top"><div><h1>dashpot</h1></div></div><div class="sheet">'
    '<div><div class="card"><h2>Files</h2></div><div class="card"><h2>Rig</h2></div></div>'
    '<div><div class="card"><p role="status" class="soft">Opening the page</p></div></div></div></div>'
)
LATER = b"""<style id="styles" media="print" onload="this.media='all'" onerror="this.media='all'">"""
LESS = ("± %", "±, noise only", "bound")
EXPORTS = {"fmu": "FMU", "mat": "MATLAB", "xml": "MuJoCo"}


def application() -> Any:
    """The page as an ASGI application; requests carry their session in their scope."""
    app = FastAPI(openapi_url=None)
    ui.page("/", title="dashpot")(_page)
    ui.run_with(
        app,
        title="dashpot",
        language="en-GB",
        dark=None,
        tailwind=False,
        storage_secret=None,
        show_welcome_message=False,
        reconnect_timeout=30.0,
    )
    # The application, whose page browsers paint before its styles are loaded: a style for print blocks
    # nothing.

    async def answer(scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] != "http" or scope["path"] != "/":
            await app(scope, receive, send)
            return
        begun: dict[str, Any] = {}
        content = bytearray()

        async def sent(message: Any) -> None:
            if message["type"] == "http.response.start":
                begun.update(message)
                return
            content.extend(message.get("body", b""))
            if message.get("more_body"):
                return
            body = bytes(content).replace(b"<style>", LATER, 1)
            kept = [pair for pair in begun["headers"] if pair[0] != b"content-length"]
            begun["headers"] = [*kept, (b"content-length", str(len(body)).encode())]
            await send(begun)
            await send({"type": "http.response.body", "body": body})

        plain = [pair for pair in scope["headers"] if pair[0] != b"accept-encoding"]
        await app({**scope, "headers": plain}, receive, sent)

    return answer


def _page() -> None:
    request = ui.context.client.request
    session = request.scope[SESSION]
    token = request.query_params.get("token") or next(
        value for name, value in request.cookies.items() if name.startswith("dashpot-")
    )
    Page(session, token).build()


def _html(text: str, classes: str = "") -> None:
    """Markup that is ours, with all that comes from files escaped before."""
    ui.html(text, sanitize=False).classes(classes)


def table_html(label: str, table: Mapping[str, Any], known: str = "") -> str:
    """A table with its name for screen readers; columns of less weight are left out on a phone."""
    right = [
        " ".join(["right"] * side + ["less"] * (head in LESS))
        for head, side in zip(table["heads"], table["right"], strict=True)
    ]
    heads = "".join(
        f'<th scope="col" class="{side}">{html.escape(head)}</th>'
        for head, side in zip(table["heads"], right, strict=True)
    )
    rows = "".join(
        f'<tr class="{"known" if known and known in row else ""}">'
        + "".join(
            f'<td class="{side}">{html.escape(cell)}</td>' for cell, side in zip(row, right, strict=True)
        )
        + "</tr>"
        for row in table["rows"]
    )
    return (
        f'<table class="grid" aria-label="{html.escape(label)}"><thead><tr>{heads}</tr></thead>'
        f"<tbody>{rows}</tbody></table>"
    )


class Page:
    """One tab: its elements, and which changes of the session it has shown."""

    def __init__(self, session: Session, token: str) -> None:
        self.session, self.token = session, token
        self.shown: dict[str, int] = {}
        self.typed = session.text  # as the session and this tab last agreed
        self.editor: Any = None
        self.asked: dict[str, Any] = {}  # fields of the form for a first rig, by their questions
        self.agreed: dict[str, str] = {}  # and what the session and this tab last agreed on in each
        self.looks, self.stale = 0, False
        self.views = {
            "files": ui.refreshable(self._files),
            "start": ui.refreshable(self._start),
            "rig": ui.refreshable(self._rig),
            "channels": ui.refreshable(self._channels),
            "work": ui.refreshable(self._work),
            "result": ui.refreshable(self._result),
            "plan": ui.refreshable(self._plan),
            "live": ui.refreshable(self._live),
            "alarm": ui.refreshable(self._alarm),
        }

    def build(self) -> None:
        """The whole page."""
        style = (STATIC / "page.css").read_text(encoding="utf-8")
        script = (STATIC / "page.js").read_text(encoding="utf-8")
        given = f"const TOKEN = {json.dumps(self.token)}, MOST = {MOST_UPLOAD};"
        ui.add_head_html(f"<style>{style}</style><script>{given}</script>")
        ui.add_body_html(f"{FIRST}<script>{script}</script>")
        ui.on("part", lambda event: self._clicked([str(text) for text in event.args]))
        ui.on("form", lambda event: self._asked_for(*map(str, event.args)))
        ui.on("refused", lambda event: self.session.complain([str(event.args)[:300]]))
        ui.on("identify", lambda _: self._later(self.session.identify))
        dark = ui.dark_mode(None)
        ui.colors(primary="#0b5fad")
        with ui.element("header").classes("top"):
            _html("<h1>dashpot</h1>")
            self.identify = self._button(
                "Identify", lambda: self._later(self.session.identify), "color=primary"
            )
            self.cancel = self._button("Cancel", lambda: self._later(self.session.cancel), "outline")
            self.undo = self._button("Undo", lambda: self._later(self.session.step, -1), "outline")
            self.redo = self._button("Redo", lambda: self._later(self.session.step, 1), "outline")
            self.report = self._button("Report", lambda: self._download("report.html"), "outline")
            _html('<button type="button" class="chip" data-new>New session</button>')
            self._button("Dark", lambda: dark.set_value(not dark.value), "flat")
            with ui.element("div").classes("alarms"):
                self._view("alarm")
        with ui.element("div").classes("sheet"):
            with ui.element("div"):
                with self._card("Files"):
                    _html(
                        '<label class="drop"><b>Rig file</b><input type="file" data-kind="rig" aria-label="Rig file" '
                        'accept=".toml"></label>'
                        '<label class="drop"><b>Data files</b><input type="file" multiple data-kind="data" '
                        'aria-label="Data files"><span class="soft">or drop files anywhere on the page</span></label>'
                        '<div id="moved" class="soft" role="status"></div>'
                    )
                    self.places = self._places(f"Open from {self.session.served.name}", self._open)
                    self.places.style("width: 100%; margin-top: .4rem")
                    self._view("files")
                    self._options()
                    self._first_rig()
                with self._card("Rig", "rig"):
                    self._view("rig")
                    self._editor()
            with ui.element("div"):
                self.bar = ui.element("div").classes("card")
                with self.bar:
                    self.words = ui.label("").props("role=status")
                    self.meter = ui.element("progress").classes("progress").props('aria-label="Progress"')
                self._view("work")
                self._view("result")
                with ui.element("div").classes("later"):
                    self._plan_form()
                    self._live_form()
                    self._view("channels")
        self._tick()
        ui.timer(0.25, self._tick)  # s between two looks at whether anything has changed

    # Small parts.

    def _view(self, part: str) -> None:
        self.shown[part] = self.session.revisions[part]
        self.views[part]()

    def _card(self, title: str, classes: str = "") -> Any:
        card = ui.element("section").classes(f"card {classes}")
        card.props["aria-label"] = title
        with card:
            _html(f"<h2>{html.escape(title)}</h2>")
        return card

    def _button(self, text: str, does: Callable[[], Any], props: str = "outline dense") -> Any:
        return ui.button(text, on_click=does).props(f"no-caps unelevated {props}")

    def _later(self, work: Callable[..., Any], *arguments: Any) -> Any:
        """Have the session work in a thread of its own; the page goes on."""
        return asyncio.to_thread(work, *arguments)

    def _address(self, name: str, show: bool = False) -> str:
        folder = (self.session.state["result"] or {}).get("folder", "")
        shown = f"&show=1&of={quote(folder)}" if show else ""
        return f"/file/{quote(name)}?token={quote(self.token)}{shown}"

    def _download(self, name: str) -> None:
        ui.download.from_url(self._address(name), name)

    def _tick(self) -> None:
        """Show what has changed since the last look."""
        session = self.session
        self.looks += 1
        if self.looks % 8 == 0 and session.result is not None and session.is_stale() != self.stale:
            self.shown["result"] = -1  # a file of the served folder has changed
        for part, view in self.views.items():
            if self.shown[part] != session.revisions[part]:
                self.shown[part] = session.revisions[part]
                view.refresh()
        job = session.job
        self.bar.set_visibility(job is not None)
        if job is not None:
            self.words.set_text(job.words)
            value = "" if job.share is None else f"value={job.share:.3f}"
            if self.meter.props.get("value") != value:
                self.meter.props(remove="value")
                self.meter.props(value)
        states = (
            (self.identify, bool(session.text and session.data) and job is None),
            (self.cancel, job is not None),
            (self.undo, session.can_undo),
            (self.redo, session.can_redo),
            (self.report, session.result is not None and "report.html" in session.result["files"]),
        )
        for button, able in states:
            if button.enabled != able:
                button.set_enabled(able)
        if session.text != self.typed:
            self.typed = session.text
            self.editor.set_value(self.typed)

    # Files, and the form for a first rig.

    def _files(self) -> None:
        session = self.session
        if session.state["rig"] and session.text:
            with ui.element("div").classes("file"):
                _html(f"<span><b>{html.escape(session.state['rig'])}</b></span>")
                self._button("Download rig", partial(self._download, session.state["rig"]), "flat dense")
        for entry in session.state["data"]:
            with ui.element("div").classes("file"):
                bytes_ = entry["size"]
                size = f"{bytes_ / 1e6:.3g} MB" if bytes_ >= 1e6 else f"{bytes_ / 1e3:.3g} kB"
                _html(f"<span>{html.escape(entry['name'])} <span class='soft'>{size}</span></span>")
                rest = ui.checkbox("at rest", value=bool(entry.get("rest")))
                rest.on_value_change(
                    lambda event, path=entry["path"]: self._later(session.set_rest, path, bool(event.value))
                )
                rest.props("dense").props["aria-label"] = (
                    f"{entry['name']} is a record at rest, for the noise"
                )
                remove = partial(self._later, session.remove_data, entry["path"])
                self._button("Remove", remove, "flat dense").props["aria-label"] = f"Remove {entry['name']}"
        self.places.set_visibility(bool(session.in_folder()))

    def _places(
        self, label: str, chosen: Callable[[str], Any] | None = None, folders_too: bool = False
    ) -> Any:
        """A list of what is in the served folder, made once: what is typed stays while its entries change."""
        found = partial(self.session.in_folder, folders_too)
        field = ui.select(found(), label=label, with_input=True).props("dense outlined")

        def renew() -> None:
            names = found()
            if names != field.options:
                field.set_options(names)

        field.on("focus", renew)
        if chosen is not None:
            field.on("update:model-value", lambda: chosen(field.value) if field.value else None)
        return field

    def _open(self, name: str) -> Any:
        self.places.set_value(None)
        return self._later(self.session.open_in_folder, name)

    def _options(self) -> None:
        """What the command has options for."""
        session = self.session
        with ui.expansion("Band, method, tolerance").props("dense").style("width: 100%"):
            for name, label, example in (
                ("band", "Band, Hz", "2:150"),
                ("method", "Method", "auto"),
                ("within", "Fits within", "2%"),
            ):
                field = ui.input(label, value=session.state["options"].get(name, ""), placeholder=example)
                field.props("dense outlined stack-label").style("width: 100%; margin-bottom: .3rem")
                field.on("change", partial(self._chosen, name, field))

    def _chosen(self, name: str, field: Any, _: Any) -> Any:
        return self._later(self.session.choose, name, field.value or "")

    def _first_rig(self) -> None:
        """The form for a first rig: made once, as what is typed or clicked must not go with what is shown anew."""
        self.form = ui.element("div")
        with self.form:
            _html("<h3>A first rig for these data</h3>")
            self.questions = ui.element("div")
            problems = ui.element("div")
            self.take = self._button(
                "Use this rig", lambda: self._later(self.session.take_first_rig), "color=primary"
            )
            with problems:
                self._view("start")

    def _start(self) -> None:
        """Fields come and go with their questions, and take an answer from elsewhere where nothing else is typed."""
        session, start = self.session, self.session.start
        shown = start is not None and not session.text
        self.form.set_visibility(shown)
        questions = {
            json.dumps([each["key"], each["ask"], each.get("choices")]): each
            for each in (start["questions"] if start is not None and shown else ())
        }
        for question in self.asked.keys() - questions.keys():
            field = self.asked.pop(question)
            typed = field.value or ""
            if typed != self.agreed.pop(question):  # it is kept for when the question comes back
                session.reply(json.loads(question)[0], typed)
            field.delete()
        with self.questions:
            for place, (question, each) in enumerate(questions.items()):
                answer = session.answer(each)
                if question not in self.asked:
                    self.asked[question] = self._question(question, each, answer).move(target_index=place)
                elif (self.asked[question].value or "") == self.agreed[question]:
                    self.asked[question].set_value(answer or None if "choices" in each else answer)
                self.agreed[question] = answer
        if start is not None and shown:
            for text in start.get("problems", ()):
                self._trouble(text)
            self.take.set_visibility(bool(start["text"]))

    def _question(self, question: str, each: Mapping[str, Any], answer: str) -> Any:
        if "choices" in each:
            field: Any = ui.select(each["choices"], label=each["ask"], value=answer or None)
        else:
            field = ui.input(each["ask"], value=answer)

        def replied() -> Any:
            """An answer counts from now on; what follows from it is shown when it is known."""
            self.agreed[question] = field.value or ""
            self.session.reply(each["key"], self.agreed[question])
            return self._later(self.session.ask_anew)

        field.on("update:model-value" if "choices" in each else "change", replied)
        return field.props("dense outlined").style("width: 100%; margin-bottom: .4rem")

    # The rig: its drawing, its parts, its text.

    def _rig(self) -> None:
        session, rig = self.session, self.session.rig
        for problem in session.problems:
            self._trouble(problem["text"], problem["line"])
        if rig is None:
            if not session.text:
                _html('<p class="soft">No rig yet: give a rig file, or data to begin one from.</p>')
            return
        drawing = rig["drawing"]
        if drawing["svg"]:
            _html(drawing["svg"], "paper parts")
        else:
            _html(f'<p class="soft">{html.escape(drawing["why"])}</p>')
        with ui.element("div").classes("row-of").style("margin: .5rem 0"):
            for part in rig["parts"]:
                value = "?" if part["value"] is None else f"{part['value']:.5g} {part['unit']}"
                self._opens(f"{part['name']} {value}", part["section"], part["name"])
            for channel in rig["channels"]:
                self._opens(f"{channel['name']} {channel['unit']}", "channels", channel["name"])
        with ui.element("div").classes("row-of"):
            for section, kind in KINDS.items():
                self._opens(f"Add {kind.lower()}", section)

    def _opens(self, text: str, section: str, name: str = "") -> None:
        """A button for a form of the rig; it says which, so that a click counts while the rig is drawn anew."""
        words, section, name = (html.escape(each) for each in (text, section, name))
        _html(
            f'<button type="button" class="chip" data-section="{section}" data-name="{name}">{words}</button>'
        )

    def _asked_for(self, section: str, name: str) -> None:
        if not name and section in KINDS and self.session.rig is not None:
            self._add_form(section)
        for of, entry, form in self._forms():
            if (of, entry["name"]) == (section, name):
                form(entry)

    def _forms(self) -> list[tuple[str, Mapping[str, Any], Callable[[Mapping[str, Any]], None]]]:
        """The parts and sensors of the rig, each with its section and what opens its form."""
        rig = self.session.rig or {"parts": (), "channels": ()}
        return [
            *((part["section"], part, self._part_form) for part in rig["parts"]),
            *(("channels", channel, self._channel_form) for channel in rig["channels"]),
        ]

    def _clicked(self, texts: Sequence[str]) -> None:
        """A click in a drawing: the form of the first part whose name one of the texts there begins with."""
        for text in texts:
            for _, entry, form in self._forms():
                if re.match(rf"{re.escape(entry['name'])}(?![\w.])", text.strip()):
                    form(entry)
                    return

    def _form(
        self,
        title: str,
        fields: Mapping[str, Any],
        done: Callable[[Mapping[str, Any]], Mapping[str, Any]],
        removal: Mapping[str, Any] | None = None,
    ) -> None:
        """A dialog of fields; `done` makes the change of the rig of their values."""
        dialog = ui.dialog()
        dialog.on("hide", dialog.delete)
        dialog.props["aria-label"] = title
        with dialog, ui.card().style("min-width: min(24rem, 90vw)"):
            _html(f"<h2>{html.escape(title)}</h2>")
            inputs = {}
            for name, (label, value, choices) in fields.items():
                field = (
                    ui.select(choices, label=label, value=value) if choices else ui.input(label, value=value)
                )
                inputs[name] = field.props("dense outlined").style("width: 100%")

            async def change(wanted: Mapping[str, Any]) -> None:
                if await asyncio.to_thread(self.session.change, wanted):
                    dialog.close()

            with ui.element("div").classes("row-of"):
                self._button(
                    "Save",
                    lambda: change(done({name: field.value for name, field in inputs.items()})),
                    "color=primary",
                )
                if removal is not None:
                    self._button("Delete", lambda: change(removal))
                self._button("Close", dialog.close, "flat")
        dialog.open()

    def _part_form(self, part: Mapping[str, Any]) -> None:
        section, name = part["section"], part["name"]
        fields: dict[str, Any] = {"name": ("Name", name, None)}
        for key, label in FIELDS.items():
            value = part[key]
            unit = f", {part['unit']}" if key == "value" else ""
            fields[key] = (label + unit, "" if value is None else f"{value:.10g}", None)
        before = {key: fields[key][1] for key in FIELDS}

        def done(given: Mapping[str, Any]) -> Mapping[str, Any]:
            changed = {key: given[key] for key in FIELDS if given[key] != before[key]}
            return {"section": section, "name": name, "rename": given["name"], "set": changed}

        self._form(
            f"{KINDS.get(section, section)} {name}",
            fields,
            done,
            {"section": section, "name": name, "remove": True},
        )

    def _channel_form(self, channel: Mapping[str, Any]) -> None:
        name, points = channel["name"], self._points()
        simple = channel["of"] in points
        fields: dict[str, Any] = {"name": ("Name: the column of the data", name, None)}
        if simple:
            fields["of"] = ("Point", channel["of"], points)
        fields["quantity"] = ("Quantity", channel["quantity"], list(QUANTITIES))
        fields["unit"] = ("Unit", channel["unit"], None)

        def done(given: Mapping[str, Any]) -> Mapping[str, Any]:
            changed = {
                key: given[key] for key in CHANNEL_FIELDS if key in given and given[key] != channel[key]
            }
            return {"section": "channels", "name": name, "rename": given["name"], "set": changed}

        self._form(f"Sensor {name}", fields, done, {"section": "channels", "name": name, "remove": True})

    def _points(self) -> list[str]:
        rig = self.session.rig
        return [] if rig is None else [point for point in rig["points"] if point != "ground"]

    def _add_form(self, section: str) -> None:
        rig = self.session.rig
        assert rig is not None
        taken = {each["name"] for each in [*rig["parts"], *rig["channels"]]} | {*rig["points"]}
        letter = {"masses": "m", "springs": "k", "dampers": "c", "inerters": "b", "channels": "a"}[section]

        def free(stem: str) -> str:
            return next(f"{stem}{n}" for n in range(1, 10_000) if f"{stem}{n}" not in taken)

        name, points = free(letter), self._points()
        fields: dict[str, Any] = {"name": ("Name", name, None)}
        if section == "masses":
            fields |= {
                "at": ("Its coordinate", free("x"), None),
                "value": ("Value, kg (empty: unknown)", "", None),
            }
        elif section == "channels":
            fields["name"] = ("Name: the column of the data", name, None)
            fields |= {
                "of": ("Point", points[0], points),
                "quantity": ("Quantity", "acceleration", list(QUANTITIES)),
                "unit": ("Unit", "m/s²", None),
            }
        else:
            whole = [*points, "ground"]
            fields |= {
                "first": ("From", whole[0], whole),
                "second": ("To", whole[-1], whole),
                "value": ("Value (empty: unknown)", "", None),
            }

        def done(given: Mapping[str, Any]) -> Mapping[str, Any]:
            entry = {key: value for key, value in given.items() if key not in ("name", "first", "second")}
            if "first" in given:
                entry = {"between": [given["first"], given["second"]], **entry}
            return {"section": section, "name": given["name"], "add": entry}

        self._form(f"Add {KINDS[section].lower()}", fields, done)

    def _editor(self) -> None:
        """The rig as text: what is typed is one edit of it as soon as the typist pauses."""

        async def typed() -> None:
            self.typed = self.editor.value or ""
            await asyncio.to_thread(self.session.write, self.typed)

        with ui.expansion("Rig as text (TOML)", value=True).style("width: 100%"):
            self.editor = ui.textarea(value=self.session.text).classes("mono").style("width: 100%")
            self.editor.props(
                'outlined input-style="height: 22rem" spellcheck=false aria-label="Text of the rig, TOML"'
            )
            self.editor.on("update:model-value", typed, throttle=0.7, leading_events=False)

    # Data: what matched, and how it looks.

    def _channels(self) -> None:
        seen = self.session.seen
        if seen is None:
            return
        with self._card("Channels"):
            for problem in seen["problems"]:
                self._trouble(problem)
            if seen["channels"]:
                heads = ["Column", "", "Point", "Quantity", "Unit in the file", "Unit of the rig"]
                rows = []
                for c in seen["channels"]:
                    there = "found" if c["found"] else "missing"
                    rows.append(
                        [
                            c["column"],
                            there,
                            c["of"],
                            c["quantity"],
                            c["file_unit"] or "none",
                            c["unit"] or "SI",
                        ]
                    )
                _html(table_html("Channels", {"heads": heads, "rows": rows, "right": [False] * 6}), "wide")
                if seen.get("unused"):
                    _html(f'<p class="soft">Not used: {html.escape(", ".join(seen["unused"][:30]))}</p>')
            for file in seen["files"]:
                for part in file["parts"]:
                    _html(f'<p class="soft">{html.escape(file["name"])}: {html.escape(part["text"])}</p>')
                    for note in part["notes"][:5]:
                        _html(f'<p class="soft">{html.escape(note)}</p>')
            for note in seen["notes"]:
                _html(f"<p>{html.escape(note)}</p>")
            for plot in seen["plots"][:40]:
                _html(f"<h3>{html.escape(plot['name'])}</h3>{plot['svg']}")

    # Errors: each stays until it is closed.

    def _work(self) -> None:
        for error in self.session.state["errors"]:
            self._trouble(
                error["text"], error.get("line"), partial(self._later, self.session.close_error, error["id"])
            )

    def _trouble(
        self, text: str, line: int | None = None, close: Callable[[], Any] | None = None, head: str = ""
    ) -> None:
        """What is wrong, with a button that copies it, and others that show its line or close it."""
        with ui.element("div").classes("trouble").props("role=alert"):
            _html((f"<b>{html.escape(head)}:</b> " if head else "") + html.escape(text))
            with ui.element("div").classes("row-of"):
                copied = html.escape(f"{head}: {text}" if head else text, quote=True)
                _html(f'<button type="button" class="chip" data-copy="{copied}">Copy</button>')
                if line:
                    _html(f'<button type="button" class="chip" data-line="{line}">Show line</button>')
                if close is not None:
                    with ui.element("button").classes("chip").props('type="button"').on("click", close):
                        ui.label("Close")

    # The answer.

    def _result(self) -> None:
        result, session = self.session.result, self.session
        if result is None:
            return
        self.stale = stale = session.is_stale()
        with (
            ui.element("section")
            .classes(f"card verdict {result['verdict']}")
            .props('role=region aria-label="Verdict"')
        ):
            if stale:
                _html(
                    '<p class="stale" role="status">Stale: rig or data have changed since. Press Identify.</p>'
                )
            _html(f'<p class="head">{html.escape(result["headline"])}</p>')
            for text in result["statements"]:
                _html(f"<p>{html.escape(text)}</p>")
            _html(f'<p class="soft">Made of {html.escape(session.made_of())}</p>')
        if result["causes"]:
            self._causes(result["causes"])
        if result["estimate"] is not None:
            self._values(result)
        with self._card("Downloads"), ui.element("div").classes("row-of"):
            for name in result["files"]:
                if name != "report.html":
                    self._button(name, partial(self._download, name))
            for end, name in EXPORTS.items() if result["estimate"] is not None else ():
                self._button(f"Make {name}", partial(self._later, session.export, end))

    def _values(self, result: Mapping[str, Any]) -> None:
        """Values, drawing, warnings, responses and modes."""
        with self._card("Values"):
            _html(table_html("Parameters", result["parameters"], known="known"), "wide")
            for text in result["remarks"]:
                _html(f'<p class="soft">{html.escape(text)}</p>')
            if result["drawing"] and result["drawing"]["svg"]:
                _html(result["drawing"]["svg"], "paper parts")
        if result["warnings"] or result["notes"]:
            with self._card("Warnings and notes"):
                for text in result["warnings"]:
                    _html(f"<p>{html.escape(text)}</p>")
                for text in result["notes"]:
                    _html(f'<p class="soft">{html.escape(text)}</p>')
        if "fit.svg" in result["files"]:
            with self._card("Measured and model"):
                address = html.escape(self._address("fit.svg", show=True))
                words = "Responses, measured and model with its 95 % band"
                _html(f'<img alt="{words}" src="{address}">', "paper")
        if result["modes"]["rows"]:
            with self._card("Modes"):
                _html(table_html("Modes", result["modes"]), "wide")
                _html("".join(f'<div class="paper">{shape}</div>' for shape in result["shapes"]), "shapes")

    def _causes(self, causes: Sequence[Mapping[str, Any]]) -> None:
        with self._card("Causes"):
            for number, cause in enumerate(causes):
                with ui.element("div").classes("cause"):
                    odds = f"<b>{cause['chance']}</b> " if "chance" in cause else ""
                    _html(
                        f"<p>{odds}{html.escape(cause['text'])}</p><p><code>{html.escape(cause['change'])}</code></p>"
                    )
                    if cause.get("text_after"):
                        button = self._button(
                            "Apply", partial(self._later, self.session.apply, number), "color=primary"
                        )
                        button.props["aria-description"] = cause["change"]

    # A test that still runs.

    def _live_form(self) -> None:
        session = self.session
        with self._card("Live test"):
            _html(
                '<p class="soft" id="live">Follow a file that grows, a folder that fills, or rows that a recorder '
                "sends, while the test runs.</p>"
            )
            with ui.element("div").classes("row-of"):
                source = self._places("File or folder", folders_too=True).style("min-width: 14rem")
                target = ui.input("Enough at ±", value="2%").props("dense outlined").style("width: 8rem")
                rate = ui.input("Sampling rate, Hz", value="").props("dense outlined").style("width: 11rem")

                def begin() -> Any:
                    return self._later(
                        session.watch, source.value or "", target.value, {"rate": rate.value.strip()}
                    )

                self._button("Start live test", begin)
            self._view("live")

    def _alarm(self) -> None:
        """What must not be missed while the rig is still mounted, in the head of the page and in its title."""
        job, live = self.session.job, self.session.live
        heads = [title for title, texts in _alarms(live or {}) if texts and job and job.call == "watch"]
        if heads:
            _html(
                f'<p class="alarm" role="alert">{html.escape(" · ".join(heads))} <a href="#live">Show</a></p>'
            )
        ui.page_title(f"{heads[0]} – dashpot" if heads else "dashpot")

    def _live(self) -> None:
        live = self.session.live
        if live is None:
            return
        if live.get("waiting"):
            _html(f'<p role="status">{html.escape(live["waiting"])}</p>')
        for title, texts in _alarms(live):
            for text in texts:
                self._trouble(text, head=title)
        if not live["history"]:
            return
        samples = [step["samples"] for step in live["history"]]
        enough = "Enough: every ± is within the target." if live["enough"] else "Not enough yet."
        said = f'<p class="head" role="status">{enough}</p><p>{html.escape(live["headline"])}</p>'
        _html(
            f'<div aria-label="Live verdict" role="group">{said}<p class="soft">{samples[-1]} samples</p></div>'
        )
        rows = [
            [
                row["name"],
                row["value"],
                row["sd"],
                row["unit"],
                f"{100 * row['share']:.2g} %" if row["share"] else "",
                "yes" if row["share"] is not None and row["share"] <= live["target"] else "not yet",
            ]
            for row in live["rows"]
        ]
        heads = ["Parameter", "Value", "±", "Unit", "± %", "Enough"]
        right = [False, True, True, False, True, False]
        _html(table_html("Live intervals", {"heads": heads, "rows": rows, "right": right}), "wide")
        for text in live.get("pictures", ()):
            _html(text)
        if live.get("next"):
            best = max(live["next"], key=lambda dwell: dwell["samples"])
            amplitudes = ", ".join(f"{name} {size:.3g}" for name, size in best["amplitudes"].items())
            words = f"{best['frequency_hz']:.4g} Hz, {best['samples']} samples ({best['time_s']:.3g} s), {amplitudes}"
            _html(f"<p><b>Next best dwell:</b> {html.escape(words)} in SI units</p>")
        elif live.get("unplanned"):
            _html(f'<p class="soft">Next dwell: {html.escape(live["unplanned"])}</p>')

    # The next test.

    def _plan_form(self) -> None:
        session = self.session
        self.next = self._card("Next test")
        with self.next:
            fields = {}
            with ui.element("div").classes("row-of"):
                for key, (label, example) in LIMITS.items():
                    field = ui.input(label, value=session.state["limits"].get(key, ""), placeholder=example)
                    fields[key] = field.props("dense outlined stack-label").style("width: 9.5rem")
            self._button(
                "Plan next test",
                lambda: self._later(
                    session.design, {key: (field.value or "").strip() for key, field in fields.items()}
                ),
            ).style("margin-top: .5rem")
            self._view("plan")

    def _plan(self) -> None:
        session = self.session
        self.next.set_visibility(session.result is not None)
        if session.result is None or session.plan is None:
            return
        if session.is_stale(of="plan"):
            _html('<p class="stale" role="status">Stale: rig or data have changed since.</p>')
        plan = session.plan["plan"]
        dwells = [
            [
                f"{dwell['frequency_hz']:.4g}",
                f"{dwell['samples']}",
                f"{dwell['time_s']:.3g}",
                ", ".join(f"{name} {size:.3g}" for name, size in dwell["amplitudes"].items()),
            ]
            for dwell in plan["dwells"]
        ]
        if dwells:
            heads = ["Frequency, Hz", "Samples", "Time, s", "Amplitude, SI units"]
            _html(
                table_html("Dwells", {"heads": heads, "rows": dwells, "right": [True, True, True, False]}),
                "wide",
            )
        else:
            _html("<p>Enough: the target is reached with the data at hand.</p>")
        expected = [
            [
                name,
                f"{each['value']:.4g}",
                f"{each['sd']:.2g}",
                each["unit"],
                f"{100 * abs(each['relative_sd'] or 0):.2g} %",
            ]
            for name, each in plan["predicted"].items()
        ]
        heads = ["Parameter", "Value", "± after it", "Unit", "± %"]
        _html(
            "<h3>Expected after it</h3>"
            + table_html(
                "Expected", {"heads": heads, "rows": expected, "right": [False, True, True, False, True]}
            ),
            "wide",
        )
        for note in plan["notes"]:
            _html(f'<p class="soft">{html.escape(note)}</p>')
        with ui.element("div").classes("row-of"):
            for name in session.plan["files"]:
                if name.startswith("plan."):
                    self._button(name, partial(self._download, name))


def _alarms(live: Mapping[str, Any]) -> tuple[tuple[str, Sequence[str]], ...]:
    damaged = (live["damaged"],) if "damaged" in live else ()
    return (
        ("Samples lost", live.get("lost", ())),
        ("Rows that cannot be read", damaged),
        ("Repeat now", live.get("bad", ())),
    )
