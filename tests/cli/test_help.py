"""Help pages and `twin options`: one screen, the defaults of a plain run, names with dashes."""

import json
import re
import subprocess
import sys
from dataclasses import fields
from typing import get_args

import pytest

from scan3d_twin.bench.spec import suite_names
from scan3d_twin.cli.app import app
from scan3d_twin.cli.commands.options import default_of
from scan3d_twin.cli.commands.sim import SimOptions, resolve
from scan3d_twin.cli.dotted import dotted_fields
from scan3d_twin.core.config import Config, Tour
from scan3d_twin.core.options import option_key
from scan3d_twin.core.presets import PRESETS
from scan3d_twin.sim.config import WORLDS, TwinConfig

SCREEN = (100, 40)
"""Columns (set in conftest.py) and lines of a terminal on which a help page must fit."""
NARROW_SCREEN = (80, 45)
"""Likewise, of a terminal as wide as most are when they open."""
PAGES = [
    (), ("sim",), ("real",), ("scan",), ("bench",), ("bench", "report"), ("replay",), ("session",),
    ("session", "info"), ("session", "drop-view"), ("calibrate",), ("doctor",), ("view",),
    ("mesh",), ("export",), ("emulate",), ("options",), ("scenes",), ("planners",),
    ("devices",), ("runs",), ("compare",), ("film",), ("console",), ("import",),
]  # fmt: skip


def words(page):
    """Return a help page without its frames and line breaks."""
    return " ".join(page.replace("│", " ").split())


def test_the_pages_are_those_of_all_commands():
    assert {page[0] for page in PAGES if page} == {n for n in app if not n.startswith("-")}


def test_the_overview_names_all_commands(twin):
    page = twin("--help").out
    rows = [line.split()[0] for line in page.splitlines() if line.startswith("  ")]
    assert {*rows} == {*app} - {"-h"}
    assert rows[:2] == ["sim", "real"]
    assert twin().out == twin("-h").out == page


@pytest.mark.parametrize("page", PAGES, ids=" ".join)
def test_each_page_fits_on_a_screen(twin, page):
    result = twin(*page, "--help")
    lines = result.out.splitlines()
    assert result.code == 0
    assert 8 < len(lines) <= SCREEN[1]
    assert max(map(len, lines)) <= SCREEN[0]
    assert "[default: False]" not in result.out


def test_each_page_fits_on_a_narrow_screen(monkeypatch):
    """In a process of its own, as a console keeps the width that it found first."""
    columns, most = NARROW_SCREEN
    program = """
import json, sys
from scan3d_twin.cli import main
for page in json.loads(sys.argv[1]):
    main([*page, "--help"])
    print(chr(12), end="")
"""
    monkeypatch.setenv("COLUMNS", str(columns))
    command = [sys.executable, "-c", program, json.dumps(PAGES)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    pages = dict(zip(PAGES, done.stdout.split(chr(12)), strict=False))
    assert "Usage: twin devices" in pages["devices",]
    assert {page: n for page, text in pages.items() if (n := len(text.splitlines())) > most} == {}
    assert max(map(len, done.stdout.splitlines())) <= columns


@pytest.mark.parametrize("command", ["sim", "real", "bench", "replay"])
def test_dotted_options_are_counted_and_listed_elsewhere(twin, command):
    page = twin(command, "--help").out
    configs = (Config, TwinConfig) if command in ("sim", "bench") else (Config,)
    count = sum(1 for _ in dotted_fields(*configs))
    assert f"{count} more options" in page
    assert "twin options [SECTION]" in page
    assert "--planning.quantile" not in page


def test_the_page_of_a_run_shows_the_defaults_of_a_plain_run(twin):
    page = words(twin("sim", "--help").out)
    rows = re.split(r" --(?=[a-z-]+ [A-Z]+ )", page)
    shown = dict(
        re.findall(r"^([a-z-]+) .*\[default: ([^\]]*)", row)[0] for row in rows if "[d" in row
    )
    effective, _ = resolve(SimOptions(), {})
    run, config, twin_config = effective.run, effective.config, effective.twin
    assert shown["scene"] == run.scene
    assert float(shown["mesh-scale"]) == run.mesh_scale
    assert shown["room"] == run.room
    assert shown["world"] == run.world
    assert shown["robot"] == twin_config.robot
    assert shown["lidar-link"] == twin_config.lidar_link
    assert float(shown["epsilon"]) == pytest.approx(1e3 * config.planning.epsilon)
    assert shown["preset"] == run.preset
    assert shown["planner"] == f"the preset's, {config.planner}"
    assert int(shown["seed"]) == run.seed
    assert int(shown["max-views"]) == config.max_views
    assert shown["tour"].startswith(config.tour)
    assert shown["optimize-for"].startswith(f"{config.optimize_for};")


def test_the_list_shows_the_defaults_of_a_plain_run(twin):
    effective, _ = resolve(SimOptions(), {})
    listed = json.loads(twin("options", "--json").out)
    for each, option in zip(listed, dotted_fields(Config, TwinConfig), strict=True):
        part = effective.config if hasattr(effective.config, option.section) else effective.twin
        assert each["key"] == f"{option.section}.{option_key(option.name)}"
        assert each["default"] == getattr(getattr(part, option.section), option.name), each["key"]
        assert each["help"]


def test_a_section_is_listed_alone(twin):
    page = twin("options", "planning").out
    flags = [line.split()[0] for line in page.splitlines() if line.startswith("  --")]
    names = [option_key(field.name) for field in fields(type(Config().planning))]
    assert flags == [f"--planning.{name.replace('_', '-')}" for name in names]
    assert (
        f"--planning.calibration FLOAT [default: {Config().planning.calibration:g}] [> 0, <= 100]"
        in page
    )
    assert "--planning.closing CHOICE [choices: none, hidden] [default: hidden]" in page
    assert "Smallest overlap tried" in page
    assert max(map(len, page.splitlines())) <= SCREEN[0]


def test_the_list_says_what_is_only_in_the_twin(twin):
    heads = [line for line in twin("options").out.splitlines() if re.match(r"[a-z]+: ", line)]
    assert [head.split(":")[0] for head in heads if head.endswith("Only in the twin.")] == [
        "lidar", "errors",
    ]  # fmt: skip
    assert len(heads) == len({option.section for option in dotted_fields(Config, TwinConfig)})


def test_an_unknown_section_lists_the_known_ones(fails):
    error = fails(2, "options", "planing")
    assert all(name in error for name in ("'planing'", "planning", "sweep", "lidar"))


@pytest.mark.parametrize("underscores", [False, True])
def test_what_is_listed_can_be_given(twin, underscores):
    """All at once, as a command line takes long to parse."""
    wanted, arguments = {}, []
    for option in dotted_fields(Config, TwinConfig):
        value = default_of(option)
        text = str(value).lower() if isinstance(value, bool) else str(value)
        flag = option.flag
        if underscores:
            flag = flag.replace("-", "_").replace("__", "--", 1)
        arguments.append(f"{flag}={text}")
        wanted[f"{option.section}__{option.name}"] = value
    _, bound, _ = app.parse_args(["sim", *arguments], exit_on_error=False, print_error=False)
    given = bound.arguments["dotted"]
    assert len(wanted) == len(arguments) > 100
    assert {name: getattr(given, name) for name in wanted} == wanted


def test_no_option_has_an_underscore_in_its_name(commands):
    names = {
        name
        for command in commands
        for argument in command.assemble_argument_collection()
        for name in argument.names
    }
    assert {"--lidar-link", "--planning.eta-min", "--max-views", "--per-view"} <= names
    assert [name for name in names if "_" in name] == []


def test_the_choices_of_a_tour_are_shown(twin):
    assert f"[choices: {', '.join(get_args(Tour))}]" in words(twin("sim", "--help").out)


@pytest.mark.parametrize(
    ("command", "option", "names"),
    [
        ("bench", "--suite", suite_names()),
        ("bench", "--presets", PRESETS),
        ("bench", "--world", WORLDS),
        ("sim", "--preset", PRESETS),
        ("sim", "--world", WORLDS),
        ("replay", "--preset", PRESETS),
    ],
)
def test_the_names_that_an_option_takes_are_shown(twin, command, option, names):
    rows = re.split(r" (?=--[a-z-]+ [A-Z]+)", words(twin(command, "--help").out))
    (row,) = [row for row in rows if row.startswith(f"{option} ")]
    told = re.sub(r"\[default: [^]]*\]", "", row.split(":", 1)[1])
    assert sorted(re.findall(r"[a-z][a-z0-9-]+", re.sub(r"\bor\b", " ", told))) == sorted(names)
