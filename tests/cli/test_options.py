import inspect
import re
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import get_type_hints

import pytest
import trimesh
from paper import paper_planning

from scan3d_twin.cli.app import app
from scan3d_twin.cli.commands.sim import SimOptions, resolve
from scan3d_twin.cli.dotted import dotted_options, field_docs, stated
from scan3d_twin.core.config import Config, preset_options
from scan3d_twin.core.errors import UnknownNameError
from scan3d_twin.core.planning_config import PlanningConfig
from scan3d_twin.sim.config import TwinConfig


def effective(*arguments: str):
    """Return the settings that the command line ``arguments`` of ``twin sim`` lead to."""
    command, bound, _ = app.parse_args(["sim", *arguments], exit_on_error=False, print_error=False)
    assert command.__name__ == "sim"
    options = bound.arguments.get("options", SimOptions())
    dotted = bound.arguments.get("dotted")
    return resolve(options, {} if dotted is None else stated(dotted))[0]


def sections():
    hints = [*get_type_hints(Config).items(), *get_type_hints(TwinConfig).items()]
    return [(name, cls) for name, cls in hints if is_dataclass(cls)]


@pytest.mark.parametrize(("section", "cls"), sections(), ids=lambda each: str(each))
def test_every_field_is_a_documented_option(section, cls):
    names = {field.name for field in fields(dotted_options(Config, TwinConfig))}
    docs = field_docs(cls.__module__)[cls.__name__]
    for field in fields(cls):
        assert f"{section}__{field.name}" in names
        assert docs[field.name].endswith((".", ",", "..."))


def test_the_help_shows_units_defaults_and_the_plain_lambda(twin):
    text = " ".join(twin("sim", "--help").out.replace("│", " ").split())
    assert "[mm]. [default: 10]" in text
    text = twin("options").out
    assert "--planning.lambda FLOAT" in text
    assert "--planning.eta-min FLOAT" in text
    assert "[rad]" in text


def test_defaults():
    settings = effective()
    assert settings.run.scene == "three_boxes"
    assert settings.run.preset == "best"
    assert settings.run.seed == 0
    assert settings.config.planning.epsilon == 0.010
    assert settings.config.max_views == 20
    assert settings.config.tour == "front"
    assert settings.twin == TwinConfig()


def test_flat_options():
    settings = effective(
        *("--scene", "sine_box", "--epsilon", "12.5", "--tour", "front", "--lidar-link", "115200"),
        *("--robot", "create2", "--planner", "siicp", "--preset", "paper", "--seed", "4"),
        *("--max-views", "3", "--target", "-0.5,2"),
    )
    assert settings.run.scene == "sine_box"
    assert settings.run.target == "-0.5,2"
    assert settings.run.seed == 4
    assert settings.config.planning.epsilon == pytest.approx(0.0125)
    assert (settings.config.tour, settings.config.max_views) == ("front", 3)
    assert settings.twin.lidar_link == "115200"


@pytest.mark.parametrize("name", ["--planning.eta_min", "--planning.eta-min"])
def test_dotted_options_in_either_spelling(name):
    assert effective(name, "0.3").config.planning.eta_min == 0.3


def test_dotted_options_of_all_sections():
    settings = effective(
        *("--planning.lambda", "0.05", "--registration.scope", "sweep"),
        *("--lidar.line-loss", "0.1", "--sweep.yaw-rate", "0.1", "--target.min-points", "9"),
    )
    assert settings.config.planning.lambda_ == 0.05
    assert settings.config.registration.scope == "sweep"
    assert settings.twin.lidar.line_loss == 0.1
    assert settings.config.sweep.yaw_rate == 0.1
    assert settings.config.target.min_points == 9


def test_the_tour_is_the_scenes_own_unless_stated():
    assert effective("--scene", "sine_box").config.tour == "full"
    assert effective("--scene", "sine_box", "--tour", "front").config.tour == "front"


def test_sources_win_in_their_order(tmp_path, monkeypatch):
    path = tmp_path / "my.toml"
    path.write_text("max_views = 5\n[planning]\ntrials = 5\nquantile = 0.5\nsigma = 0.5\n")
    monkeypatch.setenv("TWIN_PLANNING_TRIALS", "6")
    monkeypatch.setenv("TWIN_PLANNING_QUANTILE", "0.6")
    monkeypatch.setenv("TWIN_MAX_VIEWS", "6")
    settings = effective("--config", str(path), "--planning.trials", "7")
    planning = settings.config.planning
    assert (planning.trials, planning.quantile, planning.sigma) == (7, 0.6, 0.5)
    assert settings.config.max_views == 6
    assert planning.alpha == paper_planning().alpha


def test_a_preset_lies_between_defaults_and_file(tmp_path):
    path = tmp_path / "my.toml"
    path.write_text('run.preset = "paper"\nplanning.gamma = 0.7\n')
    planning = effective("--config", str(path)).config.planning
    assert (planning.gamma, planning.drift) == (0.7, paper_planning().drift)
    assert planning.drift != PlanningConfig().drift


def test_an_unknown_preset_lists_the_known_ones():
    with pytest.raises(UnknownNameError, match="paper"):
        preset_options("best of all")


def test_the_list_says_how_a_file_names_the_options_of_the_command_line(twin):
    """What it says holds: the file states what the options state."""
    text = " ".join(twin("options", "sweep").out.split())
    assert "--lidar is lidar_model; --epsilon [mm] is planning.epsilon [m];" in text
    flags = ("scene", "mesh-scale", "mesh-up", "room", "world", "preset", "seed", "target")
    (listed,) = re.findall(r"\[m\]; (.*) are in section run", text)
    assert re.findall(r"--([a-z-]+)", listed) == [*flags]
    trimesh.creation.box((0.3, 0.4, 0.5)).export("thing.stl")
    thing = str(Path("thing.stl").absolute())
    Path("my.toml").write_text(
        'max_views = 3\nlidar_model = "urg04lx"\nplanning.epsilon = 0.005\n'
        '[run]\nmesh_scale = 2.0\nmesh_up = "y"\nroom = "6x4"\n'
        'world = "harsh"\npreset = "paper"\nseed = 3\ntarget = "1,2"\n'
        f'scene = "{thing}"\n'
    )
    assert effective("--config", "my.toml") == effective(
        *("--max-views", "3", "--lidar", "urg04lx", "--epsilon", "5", "--scene", "thing.stl"),
        *("--mesh-scale", "2", "--mesh-up", "y", "--room", "6x4"),
        *("--world", "harsh", "--preset", "paper", "--seed", "3"),
        *("--target", "1,2"),
    )


@pytest.mark.parametrize("name", ["--robot", "--base"])
def test_either_name_of_an_option_wins_over_the_environment(monkeypatch, name):
    monkeypatch.setenv("TWIN_ROBOT", "create1")
    assert effective().twin.robot == "create1"
    assert effective(name, "roomba500").twin.robot == "roomba500"


@pytest.mark.parametrize(
    ("variable", "stated"),
    [
        ("TWIN_EPSILON", ("--planning.epsilon", "0.007")),
        ("TWIN_PLANNING_EPSILON", ("--epsilon", "7")),
    ],
)
def test_either_unit_of_epsilon_wins_over_the_environment(monkeypatch, variable, stated):
    monkeypatch.setenv(variable, "5")
    settings = effective(*stated)
    assert settings.config.planning.epsilon == pytest.approx(0.007)


def test_epsilon_wins_over_the_files_epsilon(tmp_path):
    Path("my.toml").write_text("planning.epsilon = 0.02")
    assert effective("--config", "my.toml").config.planning.epsilon == 0.02
    settings = effective("--config", "my.toml", "--epsilon", "5")
    assert settings.config.planning.epsilon == pytest.approx(0.005)


def test_the_command_says_what_it_does():
    assert "Digitise" in inspect.getdoc(app["sim"].default_command)
