"""One table from errors to exit codes; 0 is success and 1, a traceback, is a bug."""

from __future__ import annotations

from scan3d_twin.core.errors import (
    ConfigError,
    FileError,
    HazardError,
    LinkError,
    ScanError,
    TwinError,
)

WRONG_OPTION, PORT_OR_FILE, SCAN_FAILED, SAFETY_STOP, INTERRUPTED = 2, 3, 4, 5, 130

_TABLE: tuple[tuple[type[TwinError], int], ...] = (
    (ConfigError, WRONG_OPTION),
    (FileError, PORT_OR_FILE),
    (LinkError, PORT_OR_FILE),
    (ScanError, SCAN_FAILED),
    (HazardError, SAFETY_STOP),
)


def exit_code(error: TwinError) -> int:
    """Return the exit code for ``error``."""
    return next((code for kind, code in _TABLE if isinstance(error, kind)), 1)
