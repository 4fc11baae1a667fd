"""ASTM E57 (E2807-11) through pye57's libE57: one file with a scan and a pose per view.

The nodes are written here and not by ``pye57.E57``, whose headers name the bounds of each scan in
``world`` instead of its own frame, a temperature of 0 degC, a pressure of 0 Pa and a date in 1980.
"""

from __future__ import annotations

import hashlib
import math
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scan3d_twin import __version__
from scan3d_twin.core.errors import ConfigError, FileError
from scan3d_twin.recording.colours import view_colours_rgb
from scan3d_twin.recording.export.format import CloudFormat
from scan3d_twin.recording.export.piece import Piece
from scan3d_twin.run.folder import fresh_part

_AXES = ("X", "Y", "Z")
_CHANNELS = ("Red", "Green", "Blue")
MAX_COLOUR = 255
"""Largest value of a channel of the colours."""


def write(parts: Sequence[Piece], path: Path) -> list[Path]:
    """Write ``parts`` as the scans of the E57 file ``path``.

    Raises:
        ConfigError: pye57 is missing.
        FileError: The file cannot be written.
    """
    try:
        from pye57 import libe57
    except ImportError as error:
        raise ConfigError("E57 files need pye57 (on x86-64): pip install pye57") from error

    # Write a part file, then rename
    try:
        with fresh_part(path) as part_file:
            file = libe57.ImageFile(str(part_file), "w")
            try:
                _E57Nodes(libe57, file).write(parts)
            finally:
                file.close()
    except (OSError, libe57.E57Exception) as error:
        # The first line alone: libE57 goes on with places in its own sources
        reason = getattr(error, "strerror", None) or str(error).partition("\n")[0]
        raise FileError(f"cannot write {path}: {reason}") from error
    return [path]


class _E57Nodes:
    """Makes the nodes of one E57 file; element names and meanings as in E2807, section 8."""

    def __init__(self, libe57: Any, file: Any) -> None:
        self._lib, self._file = libe57, file

    def write(self, parts: Sequence[Piece]) -> None:
        """Write the root of the file and one scan for each of ``parts``."""
        lib, root = self._lib, self._file.root()
        self._file.extensionsAdd("", lib.E57_V1_0_URI)
        guids = [_guid(part) for part in parts]
        head = {
            "formatName": self._text("ASTM E57 3D Imaging Data File"),
            "guid": self._text(_braced(uuid.uuid5(uuid.NAMESPACE_OID, "".join(guids)))),
            "versionMajor": self._integer(lib.E57_FORMAT_MAJOR),
            "versionMinor": self._integer(lib.E57_FORMAT_MINOR),
            "e57LibraryVersion": self._text(lib.E57_LIBRARY_ID),
            "coordinateMetadata": self._text(""),
            "data3D": (scans := lib.VectorNode(self._file, True)),
            "images2D": lib.VectorNode(self._file, True),
        }
        for name, node in head.items():
            root.set(name, node)
        for part, guid in zip(parts, guids, strict=True):
            self._write_scan(scans, part, guid)

    def _write_scan(self, scans: Any, part: Piece, guid: str) -> None:
        # Single precision, so that the bounds are those of the values in the file
        points = part.model.points.astype(np.float32)
        colours = view_colours_rgb(part.model.view)
        fields: dict[str, Any] = {f"cartesian{axis}": points[:, k] for k, axis in enumerate(_AXES)}
        fields |= {f"color{channel}": colours[:, k] for k, channel in enumerate(_CHANNELS)}

        # Describe the scan
        scan = self._structure(
            guid=self._text(guid),
            name=self._text(part.name),
            description=self._text(f"scan3d_twin {__version__}"),
            pose=self._pose(part),
            colorLimits=self._structure(
                **{
                    f"color{channel}{end}": self._integer(value)
                    for channel in _CHANNELS
                    for end, value in (("Minimum", 0), ("Maximum", MAX_COLOUR))
                }
            ),
        )
        if len(points):
            scan.set("cartesianBounds", self._bounds(points))

        # Write the points
        vector = self._lib.CompressedVectorNode(
            self._file, self._prototype(points), self._lib.VectorNode(self._file, True)
        )
        scan.set("points", vector)
        scans.append(scan)
        buffers = self._lib.VectorSourceDestBuffer()
        arrays = {name: np.ascontiguousarray(values) for name, values in fields.items()}
        for name, values in arrays.items():
            buffers.append(
                self._lib.SourceDestBuffer(self._file, name, values, len(values), True, True)
            )
        writer = vector.writer(buffers)
        if len(points):
            writer.write(len(points))
        writer.close()

    def _prototype(self, points: Any) -> Any:
        """Return the fields of a point, with the bounds of their values."""
        ends = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(3),) * 2
        low, high = (end.astype(np.float64) for end in ends)
        nodes = {
            f"cartesian{axis}": self._lib.FloatNode(
                self._file, low[k], self._lib.E57_SINGLE, low[k], high[k]
            )
            for k, axis in enumerate(_AXES)
        }
        for channel in _CHANNELS:
            nodes[f"color{channel}"] = self._lib.IntegerNode(self._file, 0, 0, MAX_COLOUR)
        return self._structure(**nodes)

    def _bounds(self, points: Any) -> Any:
        """Return the bounds of ``points`` (n, 3) in the scan's own frame."""
        return self._structure(
            **{
                f"{axis.lower()}{end}": self._number(value)
                for end, values in (
                    ("Minimum", points.min(axis=0)),
                    ("Maximum", points.max(axis=0)),
                )
                for axis, value in zip(_AXES, values, strict=True)
            }
        )

    def _pose(self, part: Piece) -> Any:
        """Return where the frame of ``part`` is in the file's."""
        pose = part.T_world_piece
        half = pose.yaw / 2
        return self._structure(
            rotation=self._structure(
                w=self._number(math.cos(half)),
                x=self._number(0.0),
                y=self._number(0.0),
                z=self._number(math.sin(half)),
            ),
            translation=self._structure(
                x=self._number(pose.x), y=self._number(pose.y), z=self._number(0.0)
            ),
        )

    def _structure(self, **nodes: Any) -> Any:
        structure = self._lib.StructureNode(self._file)
        for name, node in nodes.items():
            structure.set(name, node)
        return structure

    def _text(self, text: str) -> Any:
        return self._lib.StringNode(self._file, text)

    def _integer(self, value: int) -> Any:
        return self._lib.IntegerNode(self._file, value)

    def _number(self, value: float) -> Any:
        return self._lib.FloatNode(self._file, float(value))


def _guid(part: Piece) -> str:
    """Return an identifier of ``part``; the same content has the same."""
    pose = part.T_world_piece
    points = hashlib.sha256(part.model.points.tobytes()).hexdigest()
    content = f"{part.name} {pose.x} {pose.y} {pose.yaw} {points}"
    return _braced(uuid.uuid5(uuid.NAMESPACE_OID, content))


def _braced(identifier: uuid.UUID) -> str:
    return f"{{{identifier}}}"


E57 = CloudFormat(suffix=".e57", write=write, fixed_unit="metres")
