"""Meshes as files, through trimesh, and Poisson surfaces, through Open3D."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.model.fused_cloud import Model
from scan3d_twin.core.model.mesh import Mesh
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.recording.colours import GREY, view_colours_rgb
from scan3d_twin.recording.export.format import MeshFormat

OCTREE_DEPTH = 8
"""Depth of the octree: 256 cells along 2 m are 8 mm, the spacing of the readings."""
MAX_POISSON_DISTANCE = 0.015
"""Poisson reconstruction closes every hole; surface farther than this from any point is cut away
[m]. Readings are 9 mm apart at 1 m, so that scanned surface is nearer."""


def encode_mesh(mesh: Mesh, name: str) -> bytes:
    """Return ``mesh`` as a file of trimesh's format ``name``; vertices have the views' colours.

    z is up; in glTF (glb) y is up and lengths are metres, by definition of the format.
    """
    import trimesh

    colours = np.where(mesh.view[:, None] >= 0, view_colours_rgb(np.maximum(mesh.view, 0)), GREY)
    vertices = mesh.vertices
    if name == "glb":
        vertices = np.stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]], axis=1)
    solid = trimesh.Trimesh(
        vertices, mesh.faces, vertex_colors=colours.astype(np.uint8), process=False
    )
    content: bytes | str = solid.export(file_type=name)
    return content.encode() if isinstance(content, str) else content


GLB = MeshFormat(encode=partial(encode_mesh, name="glb"), fixed_unit="metres")
OBJ = MeshFormat(encode=partial(encode_mesh, name="obj"))
PLY = MeshFormat(encode=partial(encode_mesh, name="ply"))
STL = MeshFormat(encode=partial(encode_mesh, name="stl"))


def reconstruct_poisson(model: Model) -> Mesh:
    """Return the surface through ``model`` by Kazhdan and Hoppe's screened Poisson method (2013).

    Surface that the method extrapolates across holes is cut away.

    Raises:
        ConfigError: Open3D is missing or cannot be loaded.
    """
    o3d = _open3d()
    known = model.select(np.asarray(np.isfinite(model.normals).all(axis=1)))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(known.points))
    cloud.normals = o3d.utility.Vector3dVector(known.normals)
    closed, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        cloud, depth=OCTREE_DEPTH, n_threads=1
    )
    vertices, faces = np.asarray(closed.vertices), np.asarray(closed.triangles, dtype=np.int64)
    near = Tree.of(known.points).is_near(vertices, MAX_POISSON_DISTANCE)
    faces = faces[near[faces].all(axis=1)]
    used, corners = np.unique(faces, return_inverse=True)
    return Mesh(vertices[used], corners.reshape(-1, 3), np.full(len(used), -1))


def _open3d() -> Any:
    try:
        import open3d
    except ImportError as error:
        raise ConfigError("--method poisson needs Open3D: pip install open3d") from error
    except OSError as error:
        raise ConfigError(
            f"Open3D cannot be loaded ({error}); apt install libegl1 libgl1 libgomp1 libusb-1.0-0"
        ) from error
    return open3d
