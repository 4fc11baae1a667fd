import subprocess
import sys
import zlib

import mujoco
import numpy as np
import pytest

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.png import encode_png
from scan3d_twin.sim.scenes import pictures
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.scenes.pictures import (
    HEIGHT,
    SUN,
    WIDTH,
    Eye,
    Painter,
    render_scene,
    write_png,
)


def test_a_picture_shows_the_scene_and_the_robot():
    picture = render_scene(load_scene("three_boxes"))
    assert picture.shape == (HEIGHT, WIDTH, 3)
    brown = (picture[..., 0] > picture[..., 2].astype(int) + 30).mean()
    dark = (picture.max(axis=-1) < 70).mean()
    assert brown > 0.05
    assert 0.003 < dark < 0.5


def test_walls_in_front_of_the_camera_are_cut_away(monkeypatch):
    # The camera stands outside of the narrow room: else one wall fills the picture.
    def shares():
        picture = render_scene(load_scene("corridor"))
        doors = (picture[..., 0] > picture[..., 2].astype(int) + 30).mean()
        return doors, (picture.max(axis=-1) < 70).mean()

    doors, robot = shares()
    monkeypatch.setattr(pictures, "cut_away", lambda *_: None)
    hidden_doors, hidden_robot = shares()
    assert doors > 0.04 > hidden_doors
    assert robot > 0.0005 > hidden_robot == 0.0


def test_a_geom_has_its_own_colour_before_that_of_its_material():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><asset><material name="white" rgba="1 1 1 1"/></asset><worldbody>'
        '<geom type="box" size=".2 .2 .2" rgba="1 0 0 1" material="white"/></worldbody></mujoco>'
    )
    eye = Eye(np.array([-2.0, 0.0, 0.1]), np.zeros(3))
    picture, _ = Painter(model).draw(np.zeros(0), eye, 32, 24)
    assert picture[12, 16, 0] > 100 > 10 > picture[12, 16, 2]


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


def test_the_depth_is_that_of_what_a_pixel_shows():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom type="plane" size="5 5 .1" rgba="0 0 1 1"/>'
        '<geom type="box" size=".2 .2 .2" pos="0 0 .2" rgba="1 0 0 1"/></worldbody></mujoco>'
    )
    eye = Eye(np.array([-2.0, 0.0, 0.2]), np.array([0.0, 0.0, 0.2]))
    picture, depth = Painter(model).draw(np.zeros(0), eye, 64, 48)
    assert depth[24, 32] == pytest.approx(1.8)
    assert picture[24, 32, 0] > 100 > picture[24, 32, 2]
    assert np.isinf(depth[2, 2])
    column, row, ahead = eye.project(np.array([[-0.2, 0.0, 0.2]]), 64, 48)
    assert (column[0], row[0], ahead[0]) == pytest.approx((32.0, 24.0, 1.8))


def test_a_shadow_is_darker_than_the_floor_beside_it():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom type="plane" size="5 5 .1" rgba=".8 .8 .8 1"/>'
        '<geom type="box" size=".3 .3 .02" pos="0 0 1" rgba="1 0 0 1"/></worldbody></mujoco>'
    )
    place = -np.array([SUN[0], SUN[1], 0.0]) / SUN[2]
    eye = Eye(place + np.array([-2.0, 0.0, 1.0]), place)
    picture, _ = Painter(model).draw(np.zeros(0), eye, 64, 48)
    assert picture[24, 32].max() < 0.75 * picture[24, 2].min()


def test_the_program_draws_a_scene(tmp_path):
    out = tmp_path / "picture.png"
    command = [sys.executable, "-m", "scan3d_twin.cli", "scenes", "--show", "ledge", "--out", out]
    result = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.strip() == str(out)
    assert out.read_bytes().startswith(b"\x89PNG")
