"""``twin console``: one page to start, steer and compare runs, for a robot without a screen."""

from __future__ import annotations

import json as json_module
import socket
import threading
import time
from pathlib import Path
from typing import Annotated

from scan3d_twin.cli.options import env
from scan3d_twin.cli.output import say
from scan3d_twin.run.folder import RUNS

LONG = 3600.0
"""Time between two wake-ups of a program that waits for Ctrl-C [s]."""


def console(
    folder: Path = RUNS,
    /,
    *,
    view_port: Annotated[int, env("VIEW_PORT")] = 8080,
    live_port: int | None = None,
    json: bool = False,
) -> None:
    """Serve a page to start, watch, pause, stop, compare and export runs.

    For a robot without a screen: the page is for this machine alone; from another one it is
    reached with `ssh -L 8080:127.0.0.1:8080 -L 8081:127.0.0.1:8081 ROBOT`. Served until Ctrl-C,
    which stops the run that goes on as its own Ctrl-C would: the wheels stop, its views are saved.

    Args:
        folder: Where the runs are, and new ones go.
        view_port: TCP port of the page; 0 takes a free one.
        live_port: TCP port of the live view of a run; by default the next one, or a free one.
        json: Print the page's address as JSON.
    """
    from scan3d_twin.cli.console.console import Console
    from scan3d_twin.cli.console.server import ConsoleServer

    if live_port is None:
        live_port = view_port + 1 if view_port else 0
    served = Console(folder, live_port)
    try:
        server = ConsoleServer(
            served, view_port, f"On {socket.gethostname()}; runs are in {folder}/"
        )
        with server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            found = json_module.dumps({"address": server.address})
            print(found if json else f"{server.address} (until Ctrl-C)", flush=True)
            _wait()
            server.shutdown()
    finally:
        run = served.snapshot()
        if run is not None and not served.is_idle:
            say("stopping the run; its finished views are saved")
        served.close()


def _wait() -> None:
    """Wait until Ctrl-C."""
    try:
        while True:
            time.sleep(LONG)
    except KeyboardInterrupt:
        return
