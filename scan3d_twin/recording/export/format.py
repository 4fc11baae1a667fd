"""What a format is: how a cloud, a mesh or a whole recording becomes files.

A format is one module of this package with an object of one of these classes in it, or an entry
point of another package (docs/extending.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.model.mesh import Mesh
from scan3d_twin.recording.export.piece import Piece
from scan3d_twin.recording.export.unit import NAMES, Unit


@dataclass(frozen=True, kw_only=True)
class CloudFormat:
    """A format of point clouds; has either ``encode`` or ``write``.

    Attributes:
        suffix: Of its files.
        encode: Returns a piece as the bytes of a file.
        write: Writes all pieces to a file or folder and returns the files.
        folder: Whether even a fused cloud is a folder.
        fixed_unit: Unit that the format prescribes; empty where the user may choose.
    """

    suffix: str = ""
    encode: Callable[[Piece], bytes] | None = None
    write: Callable[[Sequence[Piece], Path], list[Path]] | None = None
    folder: bool = False
    fixed_unit: str = ""


@dataclass(frozen=True, kw_only=True)
class MeshFormat:
    """A format of triangle meshes.

    Attributes:
        encode: Returns a mesh as the bytes of a file.
        fixed_unit: Unit that the format prescribes; empty where the user may choose.
    """

    encode: Callable[[Mesh], bytes]
    fixed_unit: str = ""


@dataclass(frozen=True, kw_only=True)
class RecordingFormat:
    """A format of everything that was recorded.

    Attributes:
        write: Writes the messages of a session file to a new file or folder.
        suffix: Of its file; empty for a folder.
    """

    write: Callable[[Path, Path], object]
    suffix: str = ""


Format = CloudFormat | MeshFormat | RecordingFormat


def check_unit(name: str, kind: Format, unit: Unit) -> None:
    """Check that the user may choose ``unit`` for files of the format ``kind`` called ``name``.

    Raises:
        ConfigError: There is no such unit, or the format prescribes another.
    """
    if unit not in NAMES:
        raise ConfigError(f"unknown unit '{unit}'; known: {', '.join(NAMES)}")
    fixed = NAMES["m"] if isinstance(kind, RecordingFormat) else kind.fixed_unit
    if fixed and unit != "m":
        raise ConfigError(
            f"{name} files are in {fixed} by definition: leave the unit out, or choose another "
            "format"
        )
