import struct
import zipfile

import numpy as np
import pytest

from scan3d_twin import limits
from scan3d_twin.core.errors import FileError
from scan3d_twin.core.types import RangeImage
from scan3d_twin.limits import VARIABLE
from scan3d_twin.recording.image import npz_bytes
from scan3d_twin.recording.npz import read_arrays
from scan3d_twin.recording.scans import read_image
from scan3d_twin.recording.views import view_bytes


@pytest.fixture
def arrays(session, tmp_path):
    """The arrays of a right view."""
    (tmp_path / "view.npz").write_bytes(view_bytes(session.views[0]))
    with np.load(tmp_path / "view.npz") as found:
        return dict(found)


def with_value(array, value):
    changed = array.copy()
    changed.reshape(-1)[0] = value
    return changed


WRONG = {
    "stamps": [lambda a: a[:-1], lambda a: a[None], lambda a: with_value(a, np.nan)],
    "yaws": [lambda a: a.T, lambda a: with_value(a, np.inf)],
    "ranges": [lambda a: a[:, :-1], lambda a: with_value(a, -1.0), lambda a: with_value(a, np.inf)],
    "codes": [lambda a: a.astype(float), lambda a: a[:, :1]],
    "elevations": [lambda a: a[:-1], lambda a: with_value(a, np.nan), lambda a: a[:0]],
    "beam_times": [lambda a: a[:-1], lambda a: a.astype("U8")],
    "T_base_lidar": [lambda a: a[:3], lambda a: 2 * a, lambda a: a.astype(complex)],
    "range_limits": [lambda a: a[:1], lambda a: with_value(a, np.nan), lambda a: -a],
}
"""For each array, changes that no sweep has."""


@pytest.mark.parametrize("name", WRONG)
def test_an_array_of_another_kind_shape_or_value_is_refused(arrays, tmp_path, name):
    path = tmp_path / "view.npz"
    assert isinstance(read_image(path), RangeImage)
    for change in WRONG[name]:
        path.write_bytes(npz_bytes(**{**arrays, name: change(arrays[name])}))
        with pytest.raises(FileError, match=r"view\.npz is no sweep of twin scan, sim or real: "):
            read_image(path)


def test_a_missing_array_is_named(arrays, tmp_path):
    del arrays["codes"]
    (tmp_path / "view.npz").write_bytes(npz_bytes(**arrays))
    with pytest.raises(FileError, match="no codes"):
        read_image(tmp_path / "view.npz")


def test_objects_are_never_unpickled(tmp_path):
    np.savez(tmp_path / "view.npz", stamps=np.array([{}], dtype=object))
    with pytest.raises(FileError, match=r"object \(1,\) does not fit"):
        read_image(tmp_path / "view.npz")


def test_what_a_file_expands_to_is_limited(tmp_path, monkeypatch):
    path = tmp_path / "view.npz"
    path.write_bytes(npz_bytes(stamps=np.zeros(1_000_000)))
    assert len(read_arrays(path, ["stamps"])["stamps"]) == 1_000_000
    monkeypatch.setattr(limits, "FREE_EXPANSION", 4_000_000)
    with pytest.raises(FileError, match=f"expands to 8 MB, far more than its size.*{VARIABLE}=4"):
        read_arrays(path, ["stamps"])
    monkeypatch.setattr(limits, "FREE_EXPANSION", 80_000_000)
    with zipfile.ZipFile(path, "w") as archive:
        header = b"\x93NUMPY\x01\x00v\x00"
        shape = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"
        archive.writestr("stamps.npy", header + shape.ljust(117).encode() + b"\n" + bytes(80))
    with pytest.raises(FileError, match="does not fit"):
        read_arrays(path, ["stamps"])


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_compression_that_numpy_does_not_write_is_refused(tmp_path, method):
    path = tmp_path / "view.npz"
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("stamps.npy", bytes(200))
    with pytest.raises(FileError, match="packed in a way that NumPy does not write"):
        read_arrays(path, ["stamps"])


@pytest.mark.parametrize("text", ["{'shape': (1,", "{'shape': 1", '"""', " {}\n  {}\n {}", "("])
@pytest.mark.parametrize("version", [(1, 0), (2, 0)], ids=str)
def test_a_header_that_is_not_whole_is_refused(tmp_path, text, version):
    head = text.ljust(64).encode()
    size = struct.pack("<H" if version == (1, 0) else "<I", len(head))
    path = tmp_path / "view.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("stamps.npy", b"\x93NUMPY" + bytes(version) + size + head + bytes(8))
    with pytest.raises(FileError, match=r"view\.npz is no sweep of twin scan, sim or real"):
        read_arrays(path, ["stamps"])


@pytest.mark.parametrize("content", [b"", b"no zip", b"PK\x05\x06" + bytes(18)], ids=str)
def test_what_is_no_npz(tmp_path, content):
    (tmp_path / "view.npz").write_bytes(content)
    with pytest.raises(FileError, match="is no sweep of twin scan, sim or real"):
        read_image(tmp_path / "view.npz")
