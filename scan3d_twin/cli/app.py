"""The program ``twin``: its commands, and what it says and returns when something goes wrong.

Commands are imported when they are called, so that help and typing errors answer at once.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, get_args

from cyclopts import App, CycloptsError, Parameter, UnusedCliTokensError

from scan3d_twin.cli.environment import prefer_command_line, refuse_unknown_variables
from scan3d_twin.cli.exit_codes import INTERRUPTED, WRONG_OPTION, exit_code
from scan3d_twin.cli.output import discard, say
from scan3d_twin.cli.signals import catch_ending_signals
from scan3d_twin.core.errors import ConfigError, TwinError

if TYPE_CHECKING:
    from cyclopts import ArgumentCollection

ABOUT = "Digitise things in 3D with a vacuum-cleaner robot and a small laser scanner."
COMMANDS = {
    "sim": ("sim:sim", "Digitise a scene with the twin."),
    "real": ("real:real", "Digitise with the real robot."),
    "scan": ("scan:scan", "Take one 3D image from where the robot stands."),
    "import": ("import_scans:import_scans", "Make an aligned model of another scanner's sweeps."),
    "view": ("view:view", "Show a recorded run on a web page."),
    "console": ("console:console", "Start, steer and compare runs on a web page."),
    "runs": ("runs:runs", "List the earlier runs."),
    "film": ("film:film", "Make a film of a run."),
    "compare": ("compare:compare", "Compare runs: options, results, models."),
    "export": ("export:export", "Write the model of a run for other programs."),
    "mesh": ("mesh:mesh", "Write the surface of a run's target as a triangle mesh."),
    "session": ("session:app", "Look at, repair and change what a run recorded."),
    "replay": ("replay:replay", "Repeat registration and planning on a recorded run."),
    "bench": ("bench:app", "Compare planners on many seeds in the twin."),
    "scenes": ("listing:scenes", "List the scenes."),
    "planners": ("listing:planners", "List the planners."),
    "devices": ("listing:devices", "List the lidars and bases."),
    "options": ("options:options", "List the options of the configuration, by section."),
    "doctor": ("doctor:doctor", "Check the robot, its ports and the libraries."),
    "calibrate": ("calibrate:calibrate", "Estimate the lidar's extrinsics from scans."),
    "emulate": ("emulate:emulate", "Serve the twin's base and lidar on serial ports."),
    "--install-completion": ("completion:install", "Complete commands and options in this shell."),
}
"""The commands by name: where each is defined, and what it does."""
EXIT_CODES = """\
Exit codes: 0 ok, 1 a bug, 2 wrong option, name, key or value, 3 port or file,
4 scan failed, 5 safety stop, 130 interrupted."""


def _version() -> str:
    from scan3d_twin.run.versions import format_versions

    return format_versions()


def _show_default(value: object) -> object:
    """Return what help pages show as the default ``value`` of an option; None shows nothing."""
    if value is None or value is False:
        return None
    return f"{value:g}" if isinstance(value, float) else value


def _refuse_fractions(_: App, command: tuple[str, ...], arguments: ArgumentCollection) -> None:
    """Refuse a fraction where a whole number is wanted, which cyclopts would round.

    Raises:
        ConfigError: There is one.
    """
    for argument in arguments:
        if int not in (argument.hint, *get_args(argument.hint)):
            continue
        for token in argument.tokens:
            if "." in token.value:
                name = token.keyword or argument.name
                raise ConfigError(f"{name} must be a whole number, got {token.value!r}")


app = App(
    name="twin",
    version=_version,
    version_format="plaintext",
    help=ABOUT,
    help_format="markdown",
    help_epilogue=EXIT_CODES,
    result_action="return_value",
    suppress_keyboard_interrupt=False,
    default_parameter=Parameter(negative=(), show_env_var=False, show_default=_show_default),
    config=(refuse_unknown_variables, prefer_command_line, _refuse_fractions),
)
for _name, (_place, _help) in COMMANDS.items():
    app.command(f"scan3d_twin.cli.commands.{_place}", name=_name, help=_help)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``twin`` with ``arguments``, by default the process's own, and return its exit code.

    A reader that closes the output early, such as ``head``, is no error.
    """
    catch_ending_signals()
    tokens = sys.argv[1:] if arguments is None else list(arguments)
    try:
        if tokens in ([], ["--help"], ["-h"]):
            print(_overview())
        else:
            app(tokens, exit_on_error=False, print_error=False)
        sys.stdout.flush()
    except CycloptsError as error:
        return _fail(f"{_explain(error)} See `twin {_command(tokens)}--help`.", WRONG_OPTION)
    except TwinError as error:
        return _fail(str(error), exit_code(error))
    except KeyboardInterrupt as error:
        return _fail(str(error) or "interrupted", INTERRUPTED)
    except RuntimeError as error:  # so does Python 3.11 wrap what interrupts the import of a class
        if not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        return _fail("interrupted", INTERRUPTED)
    except BrokenPipeError:
        discard(sys.stdout)
    except SystemExit as error:
        # This is how Rich, which prints the help, leaves when its reader has gone.
        if not isinstance(error.__context__, BrokenPipeError):
            raise
    return 0


def _overview() -> str:
    """Return the help page of the program; Rich would take as long as all the rest."""
    flags = {"--help": "Show this page, or that of a command.", "--version": "Show the versions."}
    rows = {**{name: text for name, (_, text) in COMMANDS.items()}, **flags}
    lines = [f"  {name:<20}  {text}" for name, text in rows.items()]
    return "\n".join(["Usage: twin COMMAND", "", ABOUT, "", *lines, "", EXIT_CODES])


def _explain(error: CycloptsError) -> str:
    """Return what is wrong with the command line, as a sentence."""
    if isinstance(error, UnusedCliTokensError):
        return f"Unexpected argument {shlex.join(error.unused_tokens or ())}."
    return str(error)


def _command(tokens: Sequence[str]) -> str:
    return f"{tokens[0]} " if tokens and tokens[0] in set(app) - {*app.help_flags} else ""


def _fail(message: str, code: int) -> int:
    say("error: " + " ".join(message.split()))
    return code
