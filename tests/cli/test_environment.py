"""Variables TWIN_* that set no option are refused as misspelt options are."""

import pytest

from scan3d_twin.cli.environment import known_variables


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("TWIN_EPSILOM", "TWIN_EPSILON"),
        ("TWIN_PLANNING_TRAILS", "TWIN_PLANNING_TRIALS"),
        ("TWIN_MAXVIEWS", "TWIN_MAX_VIEWS"),
        ("TWIN_LIDAR_PROT", "TWIN_LIDAR_PORT"),
    ],
)
def test_a_misspelt_variable_suggests_the_right_one(fails, monkeypatch, tmp_path, name, near):
    monkeypatch.setenv(name, "5")
    error = fails(2, "sim", "--out", "run")
    assert f"the variable {name} sets no option; did you mean {near}?" in error
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", ["TWIN_XYZZY", "TWIN_FOO", "TWIN_", "TWIN_MODEL"])
def test_a_variable_like_no_other_is_refused_too(fails, monkeypatch, name):
    monkeypatch.setenv(name, "")
    assert f"{name} sets no option; unset it" in fails(2, "planners")


def test_a_variable_of_another_command_is_left_alone(twin, monkeypatch):
    monkeypatch.setenv("TWIN_PORT", "/dev/ttyUSB0")
    monkeypatch.setenv("TWINS", "2")
    assert twin("planners").code == 0


@pytest.mark.parametrize("arguments", [("--help",), ("sim", "--help"), ("--version",)], ids=str)
def test_help_is_there_for_who_misspelt_a_variable(twin, monkeypatch, arguments):
    monkeypatch.setenv("TWIN_EPSILOM", "5")
    assert twin(*arguments).code == 0


def test_all_variables_of_all_commands_are_known(commands):
    read = {
        variable
        for command in commands
        for argument in command.assemble_argument_collection()
        for variable in argument.parameter.env_var or ()
    }
    assert read == known_variables()
    assert {"TWIN_SCENE", "TWIN_VIEW_PORT", "TWIN_ERRORS_COGGING"} < read
