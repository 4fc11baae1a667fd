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

from scan3d_twin.cli.arithmetic import fix_arithmetic
from scan3d_twin.cli.exit_codes import INTERRUPTED, WRONG_OPTION, exit_code
from scan3d_twin.core.errors import TwinError

COMMANDS = {
    "sim": "Digitise a scene with the twin.",
    "real": "Digitise with the real robot.",
    "scan": "Take one 3D image from here.",
    "calibrate": "Find out from scans where the lidar sits.",
    "doctor": "Look for what is wrong with the robot.",
    "view": "Show a recorded run on a web page.",
    "mesh": "Write a run's target as triangles.",
    "export": "Write a run's model for other programs.",
    "replay": "Register and plan on a recorded run.",
    "emulate": "Serve the twin's base and lidar on serial ports.",
}
"""Commands that are a function of the module of the same name, and what they do."""


def _version() -> str:
    from scan3d_twin.run.versions import version_text

    return version_text()


# The list of commands is plain text; the reader of Markdown would take as long as all the rest.
app = App(
    name="twin",
    version=_version,
    version_format="plaintext",
    help="Digitise things in 3D with a vacuum-cleaner robot and a small laser scanner.",
    help_format="plaintext",
    help_epilogue=(
        "Exit codes: 0 ok, 1 a bug, 2 wrong option, name, key or value, 3 port or file, "
        "4 scan failed, 5 safety stop, 130 interrupted."
    ),
    result_action="return_value",
    suppress_keyboard_interrupt=False,
    default_parameter=Parameter(negative=(), show_env_var=False),
)
for _name, _help in COMMANDS.items():
    _place = f"scan3d_twin.cli.commands.{_name}:{_name}"
    app.command(_place, name=_name, help=_help, help_format="markdown")
app.command(
    "scan3d_twin.cli.commands.session:app",
    name="session",
    help="Look at and change what a run recorded.",
)
app.command(
    "scan3d_twin.cli.commands.listing:scenes",
    name="scenes",
    help="List the scenes.",
    help_format="markdown",
)
app.command(
    "scan3d_twin.cli.commands.listing:planners",
    name="planners",
    help="List the planners.",
    help_format="markdown",
)
app.command(
    "scan3d_twin.cli.commands.listing:devices",
    name="devices",
    help="List the lidars and bases.",
    help_format="markdown",
)
app.command(
    "scan3d_twin.cli.commands.bench:app",
    name="bench",
    help="Run planners against planners in the twin.",
)
app.command(
    "scan3d_twin.cli.commands.completion:install",
    name="--install-completion",
    help="Complete commands and options in this shell.",
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``twin`` with ``arguments``, by default the process's own, and return its exit code."""
    fix_arithmetic()
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
