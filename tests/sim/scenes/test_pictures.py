import subprocess
import sys
import zlib

import numpy as np
import pytest

from scan3d_twin.core.errors import ConfigError, FileError
from scan3d_twin.core.png import encode_png
from scan3d_twin.sim.scenes import offscreen
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.scenes.pictures import HEIGHT, WIDTH, render_scene, write_png


def drawn(name):
    """Return the picture of a built-in scene, or skip without OpenGL."""
    try:
        return render_scene(load_scene(name))
    except ConfigError as error:
        pytest.skip(str(error))


def test_a_picture_shows_the_scene_and_the_robot():
    picture = drawn("three_boxes")
    assert picture.shape == (HEIGHT, WIDTH, 3)
    brown = (picture[..., 0] > picture[..., 2].astype(int) + 30).mean()
    dark = (picture.max(axis=-1) < 70).mean()
    assert brown > 0.05
    assert 0.003 < dark < 0.5


def test_walls_in_front_of_the_camera_are_cut_away():
    # The camera stands outside of the narrow room: else one wall would fill the picture.
    picture = drawn("corridor")
    assert picture[HEIGHT // 2 :].std() > 15


def test_a_png_holds_the_picture_it_was_made_of():
    picture = np.arange(4 * 5 * 3, dtype=np.uint8).reshape(4, 5, 3)
    data = encode_png(picture)
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    start = data.index(b"IDAT") + 4
    rows = np.frombuffer(zlib.decompress(data[start : data.index(b"IEND") - 8]), np.uint8)
    assert np.array_equal(rows.reshape(4, 16)[:, 1:].reshape(4, 5, 3), picture)


def test_a_picture_that_cannot_be_written_is_said_so(tmp_path):
    with pytest.raises(FileError, match="no_folder"):
        write_png(tmp_path / "no_folder" / "a.png", np.zeros((2, 2, 3), np.uint8))


def test_without_the_extra_the_message_names_it(monkeypatch):
    monkeypatch.setattr(offscreen.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match="pip install glfw pyopengl"):
        offscreen.open_context(10, 10)


def test_without_any_backend_the_message_names_the_packages(monkeypatch):
    pytest.importorskip("OpenGL")
    pytest.importorskip("glfw")
    monkeypatch.setattr(offscreen, "_open", lambda *_: (_ for _ in ()).throw(OSError("no driver")))
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    with pytest.raises(
        ConfigError, match=r"apt install libegl1.*apt install libosmesa6.*no driver"
    ):
        offscreen.open_context(10, 10)


def test_a_strange_backend_is_refused(monkeypatch):
    pytest.importorskip("OpenGL")
    pytest.importorskip("glfw")
    monkeypatch.setenv("MUJOCO_GL", "vulkan")
    with pytest.raises(ConfigError, match="MUJOCO_GL must be one of egl, osmesa"):
        offscreen.open_context(10, 10)


def test_the_program_draws_a_scene(tmp_path):
    drawn("three_boxes")
    out = tmp_path / "picture.png"
    command = [sys.executable, "-m", "scan3d_twin.cli", "scenes", "--show", "ledge", "--out", out]
    result = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.strip() == str(out)
    assert out.read_bytes().startswith(b"\x89PNG")
