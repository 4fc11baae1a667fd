import tomllib
from collections import Counter
from dataclasses import replace

import pytest

from scan3d_twin.bench.spec import (
    list_tasks,
    load_suite,
    make_experiment,
    read_experiment,
    select_shard,
    suite_names,
)
from scan3d_twin.core.errors import ConfigError, FileError, SceneError, UnknownNameError
from scan3d_twin.run.settings import build_settings

FILE = """
description = "an example"
options.max_views = 3
options.planning.epsilon = 0.02

[variants.a]
run.preset = "best"

[variants.b]
planner = "fixed50"
max_views = 4

[[grids]]
scenes = ["three_boxes", "plain_wall"]
seeds = 2

[[grids]]
scenes = ["three_boxes"]
variants = ["b"]
seeds = 3
first_seed = 1
"""


@pytest.fixture
def example(tmp_path):
    """The experiment of ``FILE``."""
    path = tmp_path / "example.toml"
    path.write_text(FILE)
    return read_experiment(path)


def test_a_file_says_what_meets_what(example):
    assert example.name == "example"
    found = Counter((task.scene, task.variant, task.seed) for task in list_tasks(example))
    product = {(s, v, k) for s in ("three_boxes", "plain_wall") for v in "ab" for k in (0, 1)}
    assert set(found) == product | {("three_boxes", "b", 2), ("three_boxes", "b", 3)}
    assert set(found.values()) == {1}


def test_options_of_variants_win_over_those_of_all(example):
    by_name = {task.variant: task.settings for task in list_tasks(example)}
    assert (by_name["a"].config.max_views, by_name["b"].config.max_views) == (3, 4)
    assert by_name["a"].config.planning.epsilon == by_name["b"].config.planning.epsilon == 0.02
    assert by_name["a"].run.preset == "best"
    assert by_name["b"].config.planner == "fixed50"


def test_the_command_line_wins_over_the_file(example):
    changed = example.with_options({"max_views": 9}).with_seeds(1, 5)
    assert {task.settings.config.max_views for task in list_tasks(changed)} == {9}
    assert {task.seed for task in list_tasks(changed)} == {5}


def test_all_variants_meet_the_same_seeds_and_early_ends_stay_paired(example):
    one = [task for task in list_tasks(example) if task.seed == 0]
    assert list_tasks(example)[: len(one)] == one
    assert {task.variant for task in one} == {"a", "b"}


def test_only_the_first_seed_of_a_grid_is_drawn(example):
    drawn = {task.seed for task in list_tasks(example.with_seeds(5, 3)) if task.picture}
    assert drawn == {3}


def test_the_scenes_own_options_hold_as_in_the_program():
    (front,) = list_tasks(make_experiment(["three_boxes"], [], ["paper"]))
    (full,) = list_tasks(make_experiment(["sine_box"], [], ["paper"]))
    assert (front.settings.config.tour, full.settings.config.tour) == ("front", "full")


def test_the_key_depends_on_everything_that_decides_on_the_record(a_task):
    run = a_task.settings.run
    again = replace(a_task, picture=not a_task.picture)
    others = [
        replace(a_task, variant="other"),
        a_task.with_seed(7, picture=False),
        replace(a_task, settings=replace(a_task.settings, run=replace(run, version="9.9"))),
        replace(a_task, settings=build_settings([{"planning": {"epsilon": 0.011}}])),
    ]
    assert again.key == a_task.key
    assert len({a_task.key, *(task.key for task in others)}) == 5


def test_a_scene_file_is_found_from_any_folder(tmp_path, monkeypatch):
    (tmp_path / "scene.xml").write_text(load_text("plain_wall"))
    monkeypatch.chdir(tmp_path)
    (task,) = list_tasks(make_experiment(["scene.xml"], [], ["paper"]))
    assert task.settings.run.scene == str(tmp_path / "scene.xml")
    assert task.scene == "scene"


def test_a_changed_scene_file_is_another_task(tmp_path):
    text = load_text("plain_wall")
    path = tmp_path / "scene.xml"
    keys = []
    for content in (text, text, text.replace("</mujoco>", "<!-- new --></mujoco>")):
        path.write_text(content)
        (task,) = list_tasks(make_experiment([str(path)], [], ["paper"]))
        keys.append(task.key)
    assert keys[0] == keys[1] != keys[2]


def load_text(scene):
    """Return the XML text of a built-in scene."""
    from scan3d_twin.sim.resources import find_resource_dir

    return (find_resource_dir("scenes") / f"{scene}.xml").read_text()


def test_shards_share_the_whole_between_them(example):
    whole = list_tasks(example)
    for count in (1, 2, 3, 20):
        parts = [select_shard(whole, number, count) for number in range(1, count + 1)]
        assert sorted(task.key for part in parts for task in part) == sorted(t.key for t in whole)
        assert max(map(len, parts)) - min(map(len, parts)) <= 1


def test_planners_and_presets_are_multiplied():
    found = make_experiment(["plain_wall"], ["fisher", "fixed20"], ["best", "paper"])
    assert set(found.variants) == {"fisher-best", "fixed20-best", "fisher-paper", "fixed20-paper"}
    assert set(make_experiment(["plain_wall"], ["fisher"], ["best"]).variants) == {"fisher"}
    assert set(make_experiment(["plain_wall"], [], ["best", "paper"]).variants) == {"best", "paper"}


@pytest.mark.parametrize("name", suite_names())
def test_the_suites_are_sound(name):
    suite = load_suite(name)
    assert suite.description
    assert list_tasks(suite.with_seeds(1, 0))


def test_the_smoke_suite_is_two_scenes_three_planners_three_seeds():
    chosen = list_tasks(load_suite("smoke"))
    assert len(chosen) == 18
    assert len({task.scene for task in chosen}) == 2
    assert len({task.settings.config.planner for task in chosen}) == 3
    assert {task.seed for task in chosen} == {0, 1, 2}


@pytest.mark.parametrize("name", ["paper-fig10", "paper-fig13"])
def test_the_papers_experiments_have_a_hundred_seeds_and_its_epsilon(name):
    chosen = list_tasks(load_suite(name))
    assert Counter(task.variant for task in chosen)["best"] == 100
    assert {task.settings.config.planning.epsilon for task in chosen} == {0.010}


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        (("[variants.a]", "[variant.a]"), ConfigError, "no key variant; did you mean variants"),
        (("seeds = 2", "seeds = 0"), ConfigError, "seeds must be"),
        (("first_seed = 1", "first_seed = -1"), ConfigError, "first_seed must be"),
        (('variants = ["b"]', 'variants = ["c"]'), UnknownNameError, "no variant 'c'"),
        (('scenes = ["three_boxes"]', "scenes = []"), ConfigError, "grids.scenes must be a list"),
        (("max_views = 4", "max_view = 4"), ConfigError, "variant 'b' on .*did you mean max_views"),
        (("fixed50", "fixd50"), ConfigError, "no planner 'fixd50'"),
        (("plain_wall", "plain_wal"), ConfigError, "no scene 'plain_wal'"),
        (("plain_wall", "missing.xml"), SceneError, "no file missing.xml"),
        (("seeds = 2", "seeds = "), FileError, "not valid TOML"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_mistakes_are_told(tmp_path, change, kind, message):
    path = tmp_path / "wrong.toml"
    assert change[0] in FILE
    path.write_text(FILE.replace(*change))
    with pytest.raises(kind, match=message):
        list_tasks(read_experiment(path))


def test_a_file_without_grids_is_no_experiment(tmp_path):
    path = tmp_path / "empty.toml"
    path.write_text("")
    with pytest.raises(ConfigError, match="needs"):
        read_experiment(path)
    assert tomllib.loads(FILE)["grids"]


def test_an_unknown_suite_names_the_known_ones():
    with pytest.raises(
        UnknownNameError, match="costs, full, lidars, paper-fig10, paper-fig13, smoke"
    ):
        load_suite("somke")
