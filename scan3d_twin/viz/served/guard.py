"""Who may open the live view: nobody but the reader of its address.

A page of any other origin in the same browser can reach a server on this machine. So every request
must carry the token of the printed address, directly or as a cookie, name this server as its host
(against names that are made to resolve to it), and not come from a page of another origin.
"""

from __future__ import annotations

import hmac
import ipaddress
import re
import secrets
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any
from unittest import mock
from urllib.parse import parse_qs, urlsplit

import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from scan3d_twin.core.errors import LinkError

ANYWHERE = ("", "0.0.0.0", "::")
"""Hosts that serve every machine that can reach this one."""
TOKEN_BYTES = 18
"""Random bytes of a token: 144 bits, more than can be guessed."""
_AUTHORITY = re.compile(r"(?P<name>\[[0-9a-fA-F:.]+\]|[A-Za-z0-9._-]+)(:\d{1,5})?")
VIEWER_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob: data:; "
    "worker-src 'self' blob: data:; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "font-src 'self' data:; connect-src 'self' data: blob: ws://{host} wss://{host}; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""What a page of viser may load: nothing from another host. It is one file that evaluates its own
compressed script."""


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach ``host``."""
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


class Guard:
    """Decides on each request to the server at ``host``."""

    def __init__(self, host: str, policy: str = VIEWER_POLICY) -> None:
        """Guard the server at ``host``, whose pages may load what ``policy`` says.

        Args:
            host: Address of the server.
            policy: The Content-Security-Policy; ``{host}`` stands for the host of the request.
        """
        self._policy = policy
        self.token = secrets.token_urlsafe(TOKEN_BYTES)
        self.installed = False
        self._host = host

    def refusal(self, request: Request) -> Response | None:
        """Return the refusal of ``request``, None if it is admitted."""
        headers = request.headers
        host = ", ".join(headers.get_all("Host"))
        if not self._is_own_name(host):
            return _refuse(f"{host or 'no host'} is not the address of this view")
        if any(urlsplit(each).netloc != host for each in headers.get_all("Origin")):
            return _refuse("pages of other origins have no access")
        if headers.get("Sec-Fetch-Site") in ("same-site", "cross-site") and not (
            headers.get("Sec-Fetch-Mode") == "navigate"
            and headers.get("Sec-Fetch-Dest") == "document"
        ):
            return _refuse("pages of other origins have no access")
        if not any(hmac.compare_digest(each, self.token) for each in self._tokens(request)):
            return _refuse("open the whole address that twin printed, with its token")
        return None

    def protect(self, request: Request, response: Response) -> Response:
        """Return ``response`` with the token as a cookie, and the limits of the page."""
        host = request.headers["Host"]
        cookie = f"{_cookie_name(host)}={self.token}; HttpOnly; SameSite=Strict; Path=/"
        response.headers["Set-Cookie"] = cookie
        response.headers["Content-Security-Policy"] = self._policy.format(host=host)
        response.headers["X-Frame-Options"] = "DENY"
        response.headers["Referrer-Policy"] = "no-referrer"
        response.headers["X-Content-Type-Options"] = "nosniff"
        response.headers["Cross-Origin-Resource-Policy"] = "same-origin"
        response.headers["Cache-Control"] = "no-store"
        return response

    def _is_own_name(self, host: str) -> bool:
        """Return whether the header ``host`` names this server."""
        match = _AUTHORITY.fullmatch(host)
        if match is None:
            return False
        name = match["name"].strip("[]").lower()
        if is_loopback(self._host):
            return is_loopback(name)
        try:
            ipaddress.ip_address(name)
        except ValueError:  # a name: only those of this machine, or one that others chose would do
            return name in {"localhost", self._host.lower(), socket.gethostname().lower()}
        return True

    def _tokens(self, request: Request) -> Iterator[str]:
        """Yield the tokens that ``request`` shows.

        Cookies come from all programs on this machine, so they are split as browsers join them:
        ``http.cookies`` gives none at all where one of them holds a character it does not expect.
        """
        for each in parse_qs(urlsplit(request.path).query).get("token", ()):
            yield each if each.isascii() else ""
        wanted = _cookie_name(request.headers["Host"])
        for header in request.headers.get_all("Cookie"):
            for each in header.split(";"):
                name, _, value = each.strip().partition("=")
                if name == wanted and value.isascii():
                    yield value

    @contextmanager
    def install(self, change: Callable[[Response], None]) -> Iterator[None]:
        """Let a server that starts within the context ask this guard first.

        viser offers no place for a check, so it is put between viser and ``websockets``.

        Args:
            change: Changes each answer to an admitted request.

        Raises:
            LinkError: The server did not take the guard: this version of viser is unknown.
        """
        serve = websockets.asyncio.server.serve

        def guarded(*arguments: Any, process_request: Callable[..., Any], **options: Any) -> Any:
            def checked(connection: Any, request: Request) -> Response | None:
                refused = self.refusal(request)
                if refused is not None:
                    return refused
                response = process_request(connection, request)
                if response is None:
                    return None
                change(response)
                return self.protect(request, response)

            self.installed = True
            return serve(*arguments, process_request=checked, **options)

        with mock.patch.object(websockets.asyncio.server, "serve", guarded):
            yield
        if not self.installed:
            raise LinkError("this version of viser cannot be guarded; install that of uv.lock")


def _cookie_name(host: str) -> str:
    """Return the cookie's name at ``host``; cookies do not tell ports apart."""
    return "twin_view_" + re.sub(r"[^A-Za-z0-9]", "_", host)


def _refuse(reason: str) -> Response:
    body = f"{reason}\n".encode()
    headers = Headers([("Content-Type", "text/plain; charset=utf-8"), ("Connection", "close"),
                       ("Content-Length", str(len(body))), ("X-Content-Type-Options", "nosniff"),
                       ("Cross-Origin-Resource-Policy", "same-origin")])  # fmt: skip
    return Response(HTTPStatus.FORBIDDEN, "Forbidden", headers, body)
