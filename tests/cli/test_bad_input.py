"""The user's mistakes: one line with cause and cure, the right exit code, nothing left over."""

import signal

import pytest

from scan3d_twin.cli.exit_codes import exit_code
from scan3d_twin.core import errors
from scan3d_twin.sim.scenes.load import scene_names

OPTION, FILE = 2, 3


def test_an_unknown_scene_lists_the_known_ones(fails):
    error = fails(OPTION, "sim", "--scene", "four_boxes")
    assert "'four_boxes'" in error
    assert all(name in error for name in scene_names())


def test_a_scene_file_that_does_not_exist(fails):
    assert "nowhere.xml" in fails(FILE, "sim", "--scene", "nowhere.xml")


def test_broken_xml(fails, tmp_path):
    (tmp_path / "broken.xml").write_text("<mujoco><worldbody>")
    assert "broken.xml" in fails(FILE, "sim", "--scene", "broken.xml")


def test_xml_that_is_no_scene(fails, tmp_path):
    (tmp_path / "other.xml").write_text("<html/>")
    assert "other.xml" in fails(FILE, "sim", "--scene", "other.xml")


def test_an_empty_mesh(fails, tmp_path):
    (tmp_path / "empty.stl").write_text("")
    assert "empty.stl" in fails(FILE, "sim", "--scene", "empty.stl")


def test_a_mesh_without_faces(fails, tmp_path):
    (tmp_path / "points.obj").write_text("v 0 0 0\nv 1 0 0\n")
    assert "points.obj" in fails(FILE, "sim", "--scene", "points.obj")


@pytest.mark.parametrize("name", ["noise.stl", "noise.ply", "noise.obj", "noise.glb"])
def test_a_file_that_is_not_a_mesh(fails, tmp_path, name):
    (tmp_path / name).write_bytes(bytes(range(256)) * 8)
    assert name in fails(FILE, "sim", "--scene", name)


def test_a_scene_without_a_target(fails, tmp_path):
    (tmp_path / "empty_room.xml").write_text(
        '<mujoco><worldbody><site name="spawn"/><geom size="1 1 1"/></worldbody></mujoco>'
    )
    error = fails(FILE, "sim", "--scene", "empty_room.xml")
    assert "empty_room.xml has no target" in error


@pytest.mark.parametrize(
    ("epsilon", "wanted"), [("0", "> 0"), ("-1", "> 0"), ("nan", "finite"), ("inf", "finite")]
)
def test_an_epsilon_that_is_not_positive(fails, epsilon, wanted):
    assert f"epsilon must be {wanted}" in fails(OPTION, "sim", f"--epsilon={epsilon}")


def test_an_epsilon_that_is_not_a_number(fails):
    assert "--epsilon" in fails(OPTION, "sim", "--epsilon", "10mm")


def test_a_fraction_is_no_whole_number(fails, monkeypatch):
    words = "must be a whole number, got '1.5'"
    assert f"--max-views {words}" in fails(OPTION, "sim", "--max-views", "1.5")
    assert f"--planning.trials {words}" in fails(OPTION, "sim", "--planning.trials=1.5")
    assert f"VIEW {words}" in fails(OPTION, "session", "drop-view", "run", "1.5")
    monkeypatch.setenv("TWIN_SEED", "1.5")
    assert f"TWIN_SEED {words}" in fails(OPTION, "sim")


def test_epsilon_stated_twice(fails):
    error = fails(OPTION, "sim", "--epsilon", "5", "--planning.epsilon", "0.005")
    assert "--epsilon [mm] and --planning.epsilon [m]" in error


def test_an_unwritable_out(fails, tmp_path):
    (tmp_path / "file").write_text("x")
    error = fails(FILE, "sim", "--out", "file/run")
    assert "cannot write to file/run: Not a directory" in error


def test_an_out_with_something_in_it(fails, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "model.ply").write_text("precious")
    assert "is not empty" in fails(FILE, "sim", "--out", "run")
    assert (tmp_path / "run" / "model.ply").read_text() == "precious"


def test_an_unknown_config_key(fails, tmp_path):
    (tmp_path / "my.toml").write_text("[planning]\ntrails = 8\n")
    error = fails(OPTION, "sim", "--config", "my.toml")
    assert "no key planning.trails" in error
    assert "trials" in error


def test_a_config_file_that_does_not_exist(fails):
    assert "cannot read my.toml" in fails(FILE, "sim", "--config", "my.toml")


def test_a_config_file_that_is_not_toml(fails, tmp_path):
    (tmp_path / "my.toml").write_text("trials: 8")
    assert "my.toml is not valid TOML" in fails(FILE, "sim", "--config", "my.toml")


def test_a_misspelt_option_suggests_the_right_one(fails):
    assert "Did you mean --epsilon?" in fails(OPTION, "sim", "--epsilom", "3")
    assert "Did you mean --planning.trials?" in fails(OPTION, "sim", "--planning.trails", "3")


def test_an_argument_too_many(fails):
    error = fails(OPTION, "sim", "foo", "a b")
    assert "Unexpected argument foo 'a b'. See `twin sim --help`." in error


def test_a_misspelt_command(fails):
    assert "simm" in fails(OPTION, "simm")


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--preset", "beste", "did you mean best? Known: best, paper"),
        ("--planner", "magic", "siicp"),
        ("--tour", "back", "front"),
        ("--robot", "create9", "create2"),
        ("--lidar-link", "wifi", "usb"),
        ("--seed", "-1", "seed must be >= 0"),
        ("--max-views", "0", "max_views must be >= 1"),
        ("--planning.eta-min", "1.5", "eta_min"),
        ("--registration.scope", "all", "target"),
        ("--mesh-scale", "0", "mesh_scale must be > 0"),
        ("--mesh-up", "x", "mesh_up must be auto, y, z; got 'x'"),
        ("--target", "1,2,3", "name or x,y"),
        ("--target", "the_moon", "target"),
    ],
)
def test_a_wrong_value_names_the_right_ones(fails, tmp_path, option, value, words):
    assert words in fails(OPTION, "sim", f"{option}={value}")
    assert not list(tmp_path.glob("runs/*"))


def test_every_kind_of_error_has_its_code():
    codes = {
        errors.ConfigError: 2,
        errors.UnknownNameError: 2,
        errors.FileError: 3,
        errors.SceneError: 3,
        errors.LinkError: 3,
        errors.ProtocolError: 3,
        errors.ScanError: 4,
        errors.DataLossError: 4,
        errors.HazardError: 5,
    }
    for kind, code in codes.items():
        error = kind("scene", "x", []) if kind is errors.UnknownNameError else kind("x")
        assert exit_code(error) == code


def test_signals_are_heard_even_when_the_shell_muted_them(twin):
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    twin("--version")
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
