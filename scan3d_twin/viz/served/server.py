"""The web server of the live and recorded views; by default for this machine only."""

from __future__ import annotations

import contextlib
import io
import logging
import socket
from collections.abc import Iterator

import viser

from scan3d_twin.core.errors import LinkError
from scan3d_twin.viz.branding import Branding
from scan3d_twin.viz.served.guard import ANYWHERE, Guard, is_loopback

LOOPBACK = "127.0.0.1"
BRAND = (11, 98, 196)


@contextlib.contextmanager
def open_server(host: str, port: int, title: str) -> Iterator[tuple[viser.ViserServer, str]]:
    """Serve a page at ``host`` and ``port``; yield the server and the page's address.

    The address holds a random token: without it, and for pages of other origins, nothing is served.

    Args:
        host: ``LOOPBACK`` for this machine alone; 0.0.0.0 for every machine that can reach it and
            is given the address, including the use of the buttons.
        port: TCP port; 0 takes a free one.
        title: Title of the page.

    Raises:
        LinkError: The port is in use, or the host is not an address of this machine, or the
            server did not take the guard.
    """
    chosen, guard = find_free_port(host, port), Guard(host)
    logging.getLogger("websockets").setLevel(logging.CRITICAL)  # a closed page is no error
    with contextlib.ExitStack() as opened:
        with _silence_stdout(), guard.install(Branding(title).apply):
            server = viser.ViserServer(host=host, port=chosen, label=title, verbose=False)
            opened.callback(_stop, server)  # also where it did not take the guard
        set_theme(server, dark=False)
        name = LOOPBACK if host in ANYWHERE else host
        yield server, f"http://{name}:{server.get_port()}/?token={guard.token}"


def describe_reach(host: str) -> str:
    """Return a warning of who can reach a page at ``host``; empty for this machine alone."""
    if is_loopback(host):
        return ""
    where = "every address of this machine" if host in ANYWHERE else host
    return (
        f"the page and its buttons are open at {where} to everyone who has this address with its "
        "token; it is not encrypted"
    )


def set_theme(server: viser.ViserServer, *, dark: bool) -> None:
    """Set the page's theme, light or dark, without elements that load from other machines."""
    server.gui.configure_theme(
        control_width="medium",
        dark_mode=dark,
        show_logo=False,
        show_share_button=False,
        brand_color=BRAND,
    )
    server.gui.main_panel.dock_right()


def _silence_stdout() -> contextlib.AbstractContextManager[object]:
    """Keep viser's messages out of the program's standard output."""
    return contextlib.redirect_stdout(io.StringIO())


def _stop(server: viser.ViserServer) -> None:
    with _silence_stdout():
        server.stop()


def find_free_port(host: str, port: int) -> int:
    """Return ``port`` if it is free at ``host``, or a free one for 0.

    Raises:
        LinkError: It is in use, or the host is not an address of this machine.
    """
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise LinkError(
                f"cannot serve the view at {host}:{port}: {reason}; choose another --view-port"
            ) from error
        return int(probe.getsockname()[1])
