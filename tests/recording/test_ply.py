import numpy as np
import trimesh

from scan3d_twin.recording.ply import ply_bytes


def test_another_program_reads_the_same_points(tmp_path):
    points = np.random.default_rng(0).normal(size=(50, 3))
    path = tmp_path / "model.ply"
    path.write_bytes(ply_bytes(points, np.arange(50) % 3))
    cloud = trimesh.load(path)
    np.testing.assert_array_equal(cloud.vertices, points.astype(np.float32))
    vertex = cloud.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(np.ravel(vertex["view"]), np.arange(50) % 3)


def test_no_points_are_a_valid_file_too():
    content = ply_bytes(np.zeros((0, 3)), np.zeros(0, dtype=np.int64))
    assert content.startswith(b"ply\nformat binary_little_endian 1.0\n")
    assert content.endswith(b"element vertex 0\nproperty float x\nproperty float y\n"
                            b"property float z\nproperty int view\nend_header\n")  # fmt: skip
