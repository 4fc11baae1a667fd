"""The web server of the console: for this machine alone, and only for who knows its address.

Each request passes the guard of the live view first. Refusals of the console are JSON with their
one line; the page shows it.
"""

from __future__ import annotations

import json
import os
import re
import stat
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import unquote, urlsplit

from websockets.datastructures import Headers
from websockets.exceptions import WebSocketException
from websockets.http11 import Request, Response

from scan3d_twin.cli.commands.runs import COLUMNS
from scan3d_twin.cli.console.console import COMPARISON, BusyError, Console
from scan3d_twin.cli.console.form import COMMON, KINDS, form_fields
from scan3d_twin.cli.console.run_process import OVER, STEERABLE
from scan3d_twin.core.errors import FileError, TwinError
from scan3d_twin.real.ports import usb_ports
from scan3d_twin.recording.export import list_formats
from scan3d_twin.viz.pages.page import read_asset
from scan3d_twin.viz.served.console_page import (
    FILE_POLICY,
    POLICY,
    FormField,
    render_console_page,
    render_console_style,
)
from scan3d_twin.viz.served.guard import Guard
from scan3d_twin.viz.served.server import LOOPBACK, find_free_port

MAX_BODY = 65_536
"""Most bytes of a request: a filled form has one."""
PATIENCE = 30.0
"""Longest time in which a request arrives [s]."""
CHUNK = 1 << 20
"""Part of a file that is read at once [bytes]: recordings are larger than a robot's memory."""
_SHOWN = {".html": "text/html; charset=utf-8", ".svg": "image/svg+xml"}
"""Types of the files that a browser shows; the others are saved."""

Answer = tuple[int, str, bytes]
"""Status, type and content."""


class ConsoleServer(ThreadingHTTPServer):
    """Serves the page of a console at ``LOOPBACK``."""

    daemon_threads = True

    def __init__(self, console: Console, port: int, lead: str) -> None:
        """Listen at ``port``, 0 for a free one; ``lead`` stands below the page's title.

        Raises:
            LinkError: The port is in use.
        """
        self.console, self.lead = console, lead
        self.guard = Guard(LOOPBACK, POLICY)
        super().__init__((LOOPBACK, find_free_port(LOOPBACK, port)), _Handler)

    @property
    def address(self) -> str:
        """The address of the page, with its token."""
        return f"http://{LOOPBACK}:{self.server_port}/?token={self.guard.token}"


class _Handler(BaseHTTPRequestHandler):
    """Answers the requests of one connection."""

    protocol_version = "HTTP/1.1"
    timeout = PATIENCE
    server: ConsoleServer

    def do_GET(self) -> None:
        """Answer a request for the page, or for what it shows."""
        if "Content-Length" in self.headers or "Transfer-Encoding" in self.headers:
            self.close_connection = True  # what it sent is not read
        self._answer(_GET, lambda: {})

    def do_POST(self) -> None:
        """Answer a request to do something."""
        self._answer(_POST, self._body)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: the terminal is for what is done."""

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Refuse what is no request that we know, without a page."""
        text = message or HTTPStatus(code).phrase
        self._send(_respond(code, "text/plain; charset=utf-8", f"{text}\n".encode()))
        self.close_connection = True

    def _answer(
        self, actions: Mapping[str, Callable[[ConsoleServer, Any], Any]], body: Callable[[], Any]
    ) -> None:
        """Ask the guard, then do what the path names."""
        # Ask the guard first
        try:
            request = Request(self.path, Headers(list(self.headers.items())))
            refused = self.server.guard.refusal(request)
        except (ValueError, WebSocketException):
            self.send_error(HTTPStatus.BAD_REQUEST)
            return
        if refused is not None:
            self.close_connection = True
            self._send(refused)
            return

        # Do it
        name = urlsplit(self.path).path.removeprefix("/")
        try:
            if actions is _GET and (path := self._named_file(name)) is not None:
                self._send_file(request, path)
                return
            if name not in actions:
                self.close_connection = True  # what it sent is not read
                raise FileError(f"there is no {name!r} here")
            answer = actions[name](self.server, body())
            response = _respond(*answer) if isinstance(answer, tuple) else _as_json(answer)
        except TwinError as error:
            response = _as_json({"error": " ".join(str(error).split())}, _status_of(error))
        self._send(self.server.guard.protect(request, response))

    def _body(self) -> dict[str, Any]:
        """Return the JSON object that was sent.

        Raises:
            TwinError: There is none, or more than ``MAX_BODY``.
        """
        length = self.headers.get("Content-Length", "")
        is_json = self.headers.get_content_type() == "application/json"
        if not re.fullmatch(r"\d{1,6}", length) or int(length) > MAX_BODY or not is_json:
            self.close_connection = True
            raise TwinError("a request takes one JSON object of known length")
        try:
            sent = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError, OSError):
            self.close_connection = True
            raise TwinError("a request takes one JSON object") from None
        if not isinstance(sent, dict):
            raise TwinError("a request takes one JSON object")
        return sent

    def _named_file(self, name: str) -> Path | None:
        """Return the file of a run, or the comparison, that ``name`` means; None for neither."""
        console = self.server.console
        if name == COMPARISON:
            return console.comparison
        if not name.startswith("run/"):
            return None
        place, _, file = name.removeprefix("run/").rpartition("/")
        run = console.find_run(unquote(place))
        chosen = unquote(file)
        if "/" in chosen or chosen.startswith(".") or not chosen.isprintable():
            raise FileError(f"no file {chosen!r} in {place}")
        return run.folder / chosen

    def _send_file(self, request: Request, path: Path) -> None:
        """Send a file, which may come from someone else, with an origin of its own.

        Raises:
            FileError: It is not there, a link, or no file.
        """
        with _open_file(path) as file:
            size = os.fstat(file.fileno()).st_size
            kind = _SHOWN.get(path.suffix, "application/octet-stream")
            response = self.server.guard.protect(request, _respond(HTTPStatus.OK, kind, b""))
            for key in ("Content-Length", "Content-Security-Policy"):
                del response.headers[key]
            response.headers["Content-Length"] = str(size)
            response.headers["Content-Security-Policy"] = FILE_POLICY
            if path.suffix not in _SHOWN:
                name = re.sub(r"[^A-Za-z0-9._-]", "_", path.name)
                response.headers["Content-Disposition"] = f'attachment; filename="{name}"'
            self._send(response)
            with suppress(OSError):  # the page was closed
                while size > 0 and (part := file.read(min(size, CHUNK))):
                    self.wfile.write(part)
                    size -= len(part)
        self.close_connection |= size > 0  # it shrank, or the page was closed

    def _send(self, response: Response) -> None:
        with suppress(OSError):  # the page was closed
            self.send_response_only(response.status_code)
            for key, value in response.headers.raw_items():
                self.send_header(key, value)
            self.end_headers()
            self.wfile.write(bytes(response.body))


def _respond(status: int, kind: str, body: bytes) -> Response:
    headers = Headers([("Content-Type", kind), ("Content-Length", str(len(body)))])
    return Response(status, HTTPStatus(status).phrase, headers, body)


def _as_json(content: Any, status: int = HTTPStatus.OK) -> Response:
    body = json.dumps(content, ensure_ascii=False).encode("utf-8", "replace")
    return _respond(status, "application/json; charset=utf-8", body)


def _status_of(error: TwinError) -> int:
    if isinstance(error, BusyError):
        return HTTPStatus.CONFLICT
    return HTTPStatus.NOT_FOUND if isinstance(error, FileError) else HTTPStatus.BAD_REQUEST


def _open_file(path: Path) -> BinaryIO:
    """Open the file ``path``, not through a link.

    Raises:
        FileError: It is not there, a link, or no file.
    """
    try:
        opened = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(f"cannot read {path.name}: {reason}") from None
    if stat.S_ISREG(os.fstat(opened).st_mode):
        return os.fdopen(opened, "rb")
    os.close(opened)
    raise FileError(f"{path.name} is no file")


def _show_page(server: ConsoleServer, _: Any) -> Answer:
    forms: dict[str, tuple[Sequence[FormField], Sequence[FormField]]] = {}
    for kind in KINDS:
        fields, shown = form_fields(kind), len(COMMON[kind])
        forms[kind] = (fields[:shown], fields[shown:])
    columns = [title.capitalize() for title, _, _ in COLUMNS]
    page = render_console_page(forms, _list_ports(), list_formats(), columns, server.lead)
    return HTTPStatus.OK, "text/html; charset=utf-8", page.encode()


def _list_ports() -> list[str]:
    return [str(port) for port in usb_ports()]


def _show_run(server: ConsoleServer, _: Any) -> dict[str, Any]:
    run = server.console.snapshot()
    if run is None:
        return {"run": None}
    shown = {**asdict(run), "steerable": run.state in STEERABLE, "over": run.state in OVER}
    return {"run": shown}


def _list_runs(server: ConsoleServer, _: Any) -> dict[str, Any]:
    return {"runs": [asdict(each) for each in server.console.runs()]}


def _start(server: ConsoleServer, sent: dict[str, Any]) -> dict[str, Any]:
    options = _taken(sent, "options", dict)
    server.console.start(_taken(sent, "kind", str), options, _taken(sent, "more", str))
    return _show_run(server, None)


def _resume(server: ConsoleServer, sent: dict[str, Any]) -> dict[str, Any]:
    server.console.resume(_taken(sent, "run", str))
    return _show_run(server, None)


def _pause(server: ConsoleServer, _: Any) -> dict[str, Any]:
    server.console.pause(True)
    return _show_run(server, None)


def _continue(server: ConsoleServer, _: Any) -> dict[str, Any]:
    server.console.pause(False)
    return _show_run(server, None)


def _stop(server: ConsoleServer, _: Any) -> dict[str, Any]:
    server.console.stop()
    return _show_run(server, None)


def _check(server: ConsoleServer, sent: dict[str, Any]) -> dict[str, Any]:
    findings = server.console.check(_taken(sent, "options", dict))
    return {"findings": findings, "ports": _list_ports()}


def _compare(server: ConsoleServer, sent: dict[str, Any]) -> dict[str, Any]:
    names = _taken(sent, "runs", list)
    server.console.compare([str(name) for name in names])
    return {}


def _export(server: ConsoleServer, sent: dict[str, Any]) -> dict[str, Any]:
    return {"written": server.console.export(_taken(sent, "run", str), _taken(sent, "format", str))}


def _taken(sent: dict[str, Any], name: str, kind: type) -> Any:
    """Return what was sent as ``name``.

    Raises:
        TwinError: It is missing, or of another kind.
    """
    value = sent.get(name)
    if not isinstance(value, kind):
        raise TwinError(f"the request has no {name}")
    return value


_GET: dict[str, Callable[[ConsoleServer, Any], Any]] = {
    "": _show_page,
    "console.css": lambda *_: (200, "text/css; charset=utf-8", render_console_style().encode()),
    "console.js": lambda *_: (
        200, "text/javascript; charset=utf-8", read_asset("console.js").encode(),
    ),
    "state": _show_run,
    "runs": _list_runs,
}  # fmt: skip
"""What is shown, by its path."""
_POST: dict[str, Callable[[ConsoleServer, Any], Any]] = {
    "start": _start,
    "resume": _resume,
    "pause": _pause,
    "continue": _continue,
    "stop": _stop,
    "check": _check,
    "compare": _compare,
    "export": _export,
}
"""What is done, by its path."""
