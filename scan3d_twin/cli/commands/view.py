"""``twin view``: a recorded run on a web page."""

from __future__ import annotations

import json as json_module
import time
from pathlib import Path
from typing import Annotated

from scan3d_twin.cli.options import env
from scan3d_twin.cli.output import say


def view(
    run: Path,
    /,
    *,
    host: Annotated[str, env("HOST")] = "127.0.0.1",
    view_port: Annotated[int, env("VIEW_PORT")] = 8080,
    json: bool = False,
) -> None:
    """Show a recorded run on a web page: its views, plans and a timeline.

    The page works offline and is served until Ctrl-C.

    Args:
        run: The run's folder, or its session file.
        host: Address of the page; 0.0.0.0 lets others watch who have the address with its token.
        view_port: TCP port of the page; 0 takes a free one.
        json: Print the page's address as JSON.
    """
    from scan3d_twin.recording.load import load_session
    from scan3d_twin.viz.served.server import describe_reach, open_server
    from scan3d_twin.viz.served.session_view import SessionView

    recorded = load_session(run)
    with open_server(host, view_port, f"{recorded.name} - scan3d_twin") as (server, address):
        SessionView.of_run(server, recorded)
        found = json_module.dumps({"address": address, "views": len(recorded.session.views)})
        print(found if json else f"{address} (until Ctrl-C)", flush=True)
        if warning := describe_reach(host):
            say(warning)
        try:
            while True:
                time.sleep(3600)
        except KeyboardInterrupt:
            return
