"""Which axis of a mesh file is up, as a text. This module does not import NumPy."""

from __future__ import annotations

from typing import Literal, cast, get_args

from scan3d_twin.core.errors import ConfigError

MeshUp = Literal["auto", "y", "z"]
"""The axis; auto: y in glTF by definition, else by how the thing stands."""


def parse_mesh_up(text: str) -> MeshUp:
    """Return ``text`` as an axis that is up.

    Raises:
        ConfigError: It is none.
    """
    if text not in get_args(MeshUp):
        raise ConfigError(f"mesh_up must be {', '.join(get_args(MeshUp))}; got {text!r}")
    return cast(MeshUp, text)
