"""What a format is: how a cloud, a mesh or a whole recording becomes files.

A format is one module of this package with an object of one of these classes in it, or an entry
point of another package (docs/extending.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from scan3d_twin.core.model.mesh import Mesh
from scan3d_twin.recording.export.piece import Piece


@dataclass(frozen=True, kw_only=True)
class CloudFormat:
    """A format of point clouds; has either ``encode`` or ``write``.

    Attributes:
        suffix: Of its files.
        encode: Returns a piece as the bytes of a file.
        write: Writes all pieces to a file or folder and returns the files.
        folder: Whether even a fused cloud is a folder.
    """

    suffix: str = ""
    encode: Callable[[Piece], bytes] | None = None
    write: Callable[[Sequence[Piece], Path], list[Path]] | None = None
    folder: bool = False


@dataclass(frozen=True, kw_only=True)
class MeshFormat:
    """A format of triangle meshes.

    Attributes:
        encode: Returns a mesh as the bytes of a file.
    """

    encode: Callable[[Mesh], bytes]


@dataclass(frozen=True, kw_only=True)
class RecordingFormat:
    """A format of everything that was recorded.

    Attributes:
        write: Writes the messages of a session file to a new file or folder.
    """

    write: Callable[[Path, Path], object]


Format = CloudFormat | MeshFormat | RecordingFormat
