"""Every error the library raises on purpose, named by what the caller can do about it.

TwinError
├── ConfigError          an option, name, key or value is wrong: change it
├── FileError            a file or folder is missing, unreadable, unwritable or invalid
│   └── SceneError       the scene cannot be built or has no target
├── ScanError            the scan cannot go on
│   ├── RegistrationError    two views cannot be registered
│   ├── DataLossError        lines are missing even after re-scanning
│   └── MotionTimeoutError   the robot did not get where it was sent in time
├── LinkError            a port cannot be opened or fell silent
│   ├── LinkTimeoutError     no answer in time (also a ``TimeoutError``)
│   └── ProtocolError        an answer that breaks the protocol
└── HazardError          the robot stopped for its own or someone's safety
"""

from __future__ import annotations

from collections.abc import Iterable

MIN_NAME_SIMILARITY = 0.7
"""Share of equal letters, by ``difflib``, from which one name is taken for a misspelt other one."""


class TwinError(Exception):
    """Base of all errors raised on purpose; its message is one line for the user.

    >>> try:
    ...     s3d.load_scene("no_such_scene")
    ... except s3d.TwinError as error:
    ...     print("caught:", type(error).__name__)
    caught: UnknownNameError
    """


class ConfigError(TwinError):
    """An option, name, key or value is wrong."""


class UnknownNameError(ConfigError):
    """A name is not one of the known ones; the message lists them and suggests the nearest."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        names = sorted(known)
        near = find_near_name(name, names)
        listed = ", ".join(names)
        cure = f"known: {listed}" if near is None else f"did you mean {near}? Known: {listed}"
        super().__init__(f"no {kind} {name!r}; {cure}")


def find_near_name(name: str, known: Iterable[str]) -> str | None:
    """Return which of ``known`` was probably meant by ``name``; None if nothing is near."""
    from difflib import get_close_matches

    return next(iter(get_close_matches(name, sorted(known), 1, MIN_NAME_SIMILARITY)), None)


class FileError(TwinError):
    """A file or folder is missing, unreadable, unwritable or invalid."""


class SceneError(FileError):
    """A scene cannot be built: broken XML, bad mesh, no target."""


class ScanError(TwinError):
    """The scan cannot go on."""


class RegistrationError(ScanError):
    """Two views cannot be registered."""


class DataLossError(ScanError):
    """Scan lines are missing even after re-scanning."""


class MotionTimeoutError(ScanError):
    """The robot did not get where it was sent in time."""


class LinkError(TwinError):
    """A port cannot be opened or fell silent."""


class LinkTimeoutError(LinkError, TimeoutError):
    """A device did not answer in time."""


class ProtocolError(LinkError):
    """A device answered with something its protocol does not allow."""


class HazardError(TwinError):
    """The robot stopped: bump, cliff, wheel drop, overcurrent, low battery or a silent base."""
