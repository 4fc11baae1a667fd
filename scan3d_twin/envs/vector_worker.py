"""A share of a vector environment's environments in a process of its own.

The process is a fresh interpreter that imports this module, not the caller's main module as those
of ``multiprocessing`` do. So nothing starts twice in a script without a main guard, and a program
read from standard input, which has no file to import, works too.
"""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from collections.abc import Callable
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

from gymnasium import error
from gymnasium.vector import SyncVectorEnv

from scan3d_twin.core.errors import ConfigError

_COMMAND = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[2]); "
    "from scan3d_twin.envs.vector_worker import serve; serve(int(sys.argv[1]))"
)
"""Program of the process: its arguments are the pipe's descriptor and the caller's import path."""


class Worker:
    """The caller's end of a process with a share of the environments."""

    def __init__(self, build: Callable[[], Any], count: int) -> None:
        """Start the process.

        Args:
            build: Returns a new environment; pickled.
            count: Number of environments.

        Raises:
            ConfigError: An option cannot be sent to another process.
        """
        # Pickle the environments
        try:
            job = pickle.dumps((build, count))
        except (pickle.PicklingError, AttributeError, TypeError) as failure:
            raise ConfigError(
                f"an option cannot be sent to another process ({failure}); give workers=1"
            ) from None

        # Start the process
        self._pipe, theirs = Pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-c", _COMMAND, str(theirs.fileno()), json.dumps(sys.path)],
            stdin=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
        )
        theirs.close()
        self._pipe.send_bytes(job)

    def send(self, method: str, arguments: tuple[Any, ...]) -> None:
        """Start ``method`` of the environments."""
        try:
            self._pipe.send((method, arguments))
        except OSError:
            raise _died() from None

    def receive(self) -> Any:
        """Return the result of the last method sent, or raise its error."""
        try:
            result, failure = self._pipe.recv()
        except (EOFError, OSError):
            raise _died() from None
        if failure is not None:
            raise failure
        return result

    def close(self) -> None:
        """End the process; a second call does nothing."""
        self._pipe.close()
        self._process.wait()


def _died() -> error.Error:
    return error.Error("a process of the batched environments has died; its message is above")


def serve(descriptor: int) -> None:
    """Serve environments on the pipe of this ``descriptor`` until the other end closes it."""
    pipe = Connection(descriptor)
    envs: Any = None
    failed: Exception | None = None

    # Build the environments
    try:
        build, count = pickle.loads(pipe.recv_bytes())
        envs = SyncVectorEnv([build] * count)
    except EOFError:
        return
    except AttributeError as failure:  # the caller's main module is not imported here
        failed = ConfigError(
            f"an option is defined in the main program ({failure}); move it to a module that can "
            "be imported, or give workers=1"
        )
    except Exception as failure:  # noqa: BLE001 - it is raised where the call came from
        failed = failure

    # Answer calls
    while True:
        try:
            method, arguments = pipe.recv()
        except (EOFError, OSError):
            break
        try:
            pipe.send((None, failed) if failed else (call_method(envs, method, arguments), None))
        except Exception as failure:  # noqa: BLE001 - it is raised where the call came from
            pipe.send((None, failure))
    if envs is not None:
        envs.close()


def call_method(envs: SyncVectorEnv, method: str, arguments: tuple[Any, ...]) -> Any:
    """Return the result of ``step`` or ``reset`` of ``envs``."""
    if method == "step":
        return envs.step(*arguments)
    seeds, options = arguments
    return envs.reset(seed=seeds, options=options)
