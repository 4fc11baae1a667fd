"""The program ``twin``: its commands, and what it says and returns when something goes wrong.

Commands are imported when they are called, so that help and typing errors answer at once.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType
from typing import NoReturn

from cyclopts import App, CycloptsError, Parameter

from scan3d_twin.cli.exit_codes import INTERRUPTED, WRONG_OPTION, exit_code
from scan3d_twin.cli.versions import version_text
from scan3d_twin.core.errors import TwinError

app = App(
    name="twin",
    version=version_text,
    version_format="plaintext",
    help="Digitise things in 3D with a vacuum-cleaner robot and a small laser scanner.",
    help_epilogue=(
        "Exit codes: 0 ok, 1 a bug, 2 wrong option, name, key or value, 3 port or file, "
        "4 scan failed, 5 safety stop, 130 interrupted."
    ),
    result_action="return_value",
    suppress_keyboard_interrupt=False,
    default_parameter=Parameter(negative=(), show_env_var=False),
)
app.command("scan3d_twin.cli.sim:sim", name="sim", help="Digitise a scene with the twin.")
app.command("scan3d_twin.cli.real:real", name="real", help="Digitise with the real robot.")
app.command("scan3d_twin.cli.scan:scan", name="scan", help="Take one 3D image from here.")
app.command(
    "scan3d_twin.cli.calibrate:calibrate",
    name="calibrate",
    help="Find out from scans where the lidar sits.",
)
app.command(
    "scan3d_twin.cli.doctor:doctor", name="doctor", help="Look for what is wrong with the robot."
)
app.command("scan3d_twin.cli.view:view", name="view", help="Show a recorded run on a web page.")
app.command("scan3d_twin.cli.mesh:mesh", name="mesh", help="Write a run's target as triangles.")
app.command(
    "scan3d_twin.cli.export:export", name="export", help="Write a run's model for other programs."
)
app.command(
    "scan3d_twin.cli.session:app", name="session", help="Look at and change what a run recorded."
)
app.command(
    "scan3d_twin.cli.replay:replay", name="replay", help="Register and plan on a recorded run."
)
app.command("scan3d_twin.cli.listing:scenes", name="scenes", help="List the scenes.")
app.command("scan3d_twin.cli.listing:planners", name="planners", help="List the planners.")
app.command(
    "scan3d_twin.cli.bench:app", name="bench", help="Run planners against planners in the twin."
)
app.command(
    "scan3d_twin.cli.emulate:emulate",
    name="emulate",
    help="Serve the twin's base and lidar on serial ports.",
)
app.register_install_completion_command(help="Complete commands and options in this shell.")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``twin`` with ``arguments``, by default the process's own, and return its exit code."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, _interrupt)
    tokens = sys.argv[1:] if arguments is None else list(arguments)
    try:
        app(tokens, exit_on_error=False, print_error=False)
    except CycloptsError as error:
        return _fail(f"{error} See `twin {_command(tokens)}--help`.", WRONG_OPTION)
    except TwinError as error:
        return _fail(str(error), exit_code(error))
    except KeyboardInterrupt as error:
        return _fail(str(error) or "interrupted", INTERRUPTED)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


def _command(tokens: Sequence[str]) -> str:
    return f"{tokens[0]} " if tokens and tokens[0] in set(app) - {*app.help_flags} else ""


def _fail(message: str, code: int) -> int:
    print("error:", " ".join(message.split()), file=sys.stderr)
    return code
