"""What stands between the network and the page: hosts, origins and tokens checked, uploads and downloads of files.

Plain ASGI, so that it needs no web framework; what it lets through goes to the page with the session in its scope.
"""

from __future__ import annotations

import asyncio
import hashlib
import ipaddress
import json
import os
import shutil
import socket
from collections.abc import Awaitable, Callable, Iterable, Mapping, MutableMapping
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, quote, urlsplit

from dashpot.app.serve.feed import LiveFile
from dashpot.app.serve.session import MOST_RIG, Session, Sessions, safe_name
from dashpot.errors import UsageError, printable

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

SESSION = "dashpot.session"  # key of the session in the scope of a request
MOST_UPLOAD = 1 << 30  # bytes of one file
KINDS = {
    ".svg": "image/svg+xml",
    ".html": "text/html; charset=utf-8",
    ".json": "application/json",
    ".csv": "text/csv; charset=utf-8",
    ".toml": "text/plain; charset=utf-8",
}
NO_TOKEN = (
    "the address lacks its token, or the token is wrong: open the address that dashpot serve has printed"
)
# NiceGUI's own page needs scripts in the page and templates compiled in it; nothing comes from or goes to elsewhere.
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; object-src 'none'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class RefusedError(Exception):
    """A request that is not answered: status and one line."""

    def __init__(self, status: int, line: str) -> None:
        self.status, self.line = status, line
        super().__init__(line)


class Guard:
    """The page's application behind checks of every request."""

    def __init__(self, app: App, sessions: Sessions, hosts: Iterable[str], port: int) -> None:
        self.app, self.sessions, self.cookie = app, sessions, f"dashpot-{port}"
        self.any_address = not {"0.0.0.0", "::"}.isdisjoint(hosts)
        self.hosts = {"localhost", "127.0.0.1", "::1", *(host.lower() for host in hosts)}
        if self.any_address:
            self.hosts.add(socket.gethostname().lower())

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or hand it on."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {key.decode("latin-1").lower(): value.decode("latin-1") for key, value in scope["headers"]}
        query = {key: values[-1] for key, values in parse_qs(scope["query_string"].decode("latin-1")).items()}
        try:
            self._require_own(headers)
            token = query.get("token") or self._cookie(headers)
            session = await asyncio.to_thread(self.sessions.of, token)
            if session is None:
                raise RefusedError(403, NO_TOKEN)
            if scope["type"] == "websocket":
                await self.app({**scope, SESSION: session}, receive, send)
                return
            await self._answer(scope, receive, send, session, str(token), headers, query)
        except RefusedError as refused:
            await _refuse(scope, receive, send, refused)

    def _require_own(self, headers: Mapping[str, str]) -> None:
        """Raises RefusedError for a name that is not this server's, which DNS may point here, and for others' pages."""
        host = headers.get("host", "")
        name = (urlsplit(f"//{host}").hostname or "").lower()
        if name not in self.hosts and not (self.any_address and _is_address(name)):
            raise RefusedError(403, f"this server is not called {printable(host)[:80] or '(no host)'}")
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
            raise RefusedError(403, f"requests from {printable(origin)[:80]} are not answered")

    def _cookie(self, headers: Mapping[str, str]) -> str | None:
        try:
            kept = SimpleCookie(headers.get("cookie", "")).get(self.cookie)
        except CookieError:
            return None
        return None if kept is None else kept.value

    async def _answer(
        self,
        scope: Scope,
        receive: Receive,
        send: Send,
        session: Session,
        token: str,
        headers: Mapping[str, str],
        query: Mapping[str, str],
    ) -> None:
        path, method = str(scope["path"]), str(scope["method"])
        if path == "/upload" and method == "POST":
            # The token in the address proves that our own page sends it: another's has the cookie at most.
            if "token" not in query:
                raise RefusedError(403, NO_TOKEN)
            try:
                await _take(receive, session, headers, query)
            except RefusedError as refused:
                session.complain([refused.line])
                raise
            await _send(send, 200, b"{}", {"Content-Type": "application/json"})
        elif path == "/stream" and method in ("POST", "PUT"):
            if "token" not in query:
                raise RefusedError(403, NO_TOKEN)
            await _append(receive, session, safe_name(query.get("name", ""), "stream"))
            await _send(send, 200, b"{}", {"Content-Type": "application/json"})
        elif path == "/new" and method == "POST":
            if "token" not in query:
                raise RefusedError(403, NO_TOKEN)
            content = json.dumps({"token": self.sessions.new()}).encode()
            await _send(send, 200, content, {"Content-Type": "application/json"})
        elif path.startswith("/file/") and method in ("GET", "HEAD"):
            await _give(send, session, path.removeprefix("/file/"), "show" in query, method == "HEAD")
        else:
            await self.app({**scope, SESSION: session}, receive, self._with_headers(send, path, token))

    def _with_headers(self, send: Send, path: str, token: str) -> Send:
        """`send` with what browsers are told on every page, and the cookie on the page itself."""
        own = dict(HEADERS)
        if path == "/":
            own["Set-Cookie"] = f"{self.cookie}={token}; Path=/; HttpOnly; SameSite=Strict"
            own["Cache-Control"] = "no-store"

        async def sent(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                kept = [pair for pair in message.get("headers", ()) if pair[0].decode().title() not in own]
                message = {**message, "headers": [*kept, *_encoded(own)]}
            await send(message)

        return sent


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


async def _take(
    receive: Receive, session: Session, headers: Mapping[str, str], query: Mapping[str, str]
) -> None:
    """Put an upload on disk as it comes.  Raises RefusedError if it is too large, or breaks off."""
    name, kind = query.get("name", ""), query.get("kind", "data")
    safe, of_rig = safe_name(name), kind == "rig"
    most = MOST_RIG if of_rig else MOST_UPLOAD
    # Uploads leave 100 MiB of the disk.
    most = min(most, max(shutil.disk_usage(session.folder).free - (100 << 20), 0))
    said = f"{printable(safe)}: files of at most {_size(most)} are taken"
    if of_rig:
        said = f"{printable(safe)}: a rig file may have {_size(most)} at most; is this a data file?"
    stated = headers.get("content-length", "")
    if stated.isdigit() and int(stated) > most:
        raise RefusedError(413, said)
    place = await asyncio.to_thread(session.data_place, safe)
    part, digest, size, whole = place.with_name(f".{place.name}.part"), hashlib.sha256(), 0, False
    try:
        with part.open("wb") as file:
            while True:
                message = await receive()
                if message["type"] != "http.request":
                    raise RefusedError(400, f"{printable(safe)}: the upload broke off; send it again")
                body = message.get("body", b"")
                size += len(body)
                if size > most:
                    raise RefusedError(413, said)
                digest.update(body)
                file.write(body)
                if not message.get("more_body", False):
                    break
        if not size:
            raise RefusedError(400, f"{printable(safe)}: the file is empty")
        if of_rig or (kind == "drop" and _is_rig(part)):
            try:
                text = part.read_bytes().decode("utf-8-sig")
            except UnicodeDecodeError:
                raise RefusedError(
                    400, f"{printable(safe)}: a rig file is text in UTF-8; is this a data file?"
                ) from None
            await asyncio.to_thread(session.put_rig, safe, text.replace("\r\n", "\n"))
            return
        os.replace(part, place)
        whole = True
        await asyncio.to_thread(session.add_data, place, digest.hexdigest())
    except OSError as error:
        line = f"{printable(safe)}: cannot be kept ({error.strerror or error}); check the space left"
        raise RefusedError(507, line) from None
    finally:
        part.unlink(missing_ok=True)
        if not whole:
            place.unlink(missing_ok=True)


async def _append(receive: Receive, session: Session, name: str) -> None:
    """Add what a recorder sends to a live file, as it comes.  Raises RefusedError if that is too large."""
    try:
        with LiveFile(session.live_place(name)) as live:
            while True:
                message = await receive()
                live.write(message.get("body", b""))
                if message["type"] != "http.request" or not message.get("more_body", False):
                    return
    except UsageError as error:
        raise RefusedError(409, str(error)) from None


def _is_rig(path: Path) -> bool:
    """Whether a dropped file is a rig file, not data or a manifest of them."""
    if path.name.lower().removesuffix(".part").endswith(".toml") and path.stat().st_size <= MOST_RIG:
        return b"[[files]]" not in path.read_bytes()
    return False


def _size(bytes_: int) -> str:
    return f"{bytes_ / 2**30:.3g} GB" if bytes_ >= 2**30 else f"{bytes_ / 2**20:.3g} MB"


async def _give(send: Send, session: Session, name: str, shown: bool, head: bool) -> None:
    """A file of the results, to be saved or, of pictures and reports, to be looked at apart from the page."""
    place = session.download(name)
    if place is None or not place.is_file():
        raise RefusedError(404, f"there is no file {printable(name)[:80]}")
    content = b"" if head else await asyncio.to_thread(place.read_bytes)
    how = "inline" if shown else "attachment"
    headers = {
        **HEADERS,
        "Content-Type": KINDS.get(place.suffix.lower(), "application/octet-stream"),
        "Content-Disposition": f"{how}; filename*=UTF-8''{quote(place.name)}",
        "Content-Security-Policy": "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; "
        "style-src 'unsafe-inline'; img-src data:; font-src data:",
        "Cache-Control": "no-store",
    }
    await _send(send, 200, content, headers)


async def _refuse(scope: Scope, receive: Receive, send: Send, refused: RefusedError) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": refused.line[:100]})
        return
    headers = {**HEADERS, "Content-Type": "text/plain; charset=utf-8", "Connection": "close"}
    await _send(send, refused.status, f"dashpot: {refused.line}\n".encode(), headers)


async def _send(send: Send, status: int, content: bytes, headers: Mapping[str, str]) -> None:
    whole = {"Content-Length": str(len(content)), **headers}
    await send({"type": "http.response.start", "status": status, "headers": _encoded(whole)})
    await send({"type": "http.response.body", "body": content})


def _encoded(headers: Mapping[str, str]) -> list[tuple[bytes, bytes]]:
    return [(key.lower().encode("latin-1"), value.encode("latin-1")) for key, value in headers.items()]
