"""Every option of a configuration is checked where it is built."""

import math
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
import pytest

from scan3d_twin.core.config import Config, MotionConfig
from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.core.options import number, parse_options
from scan3d_twin.run.settings import Settings, build_settings


def tables_of(value: Any) -> list[Any]:
    """Return the dataclass ``value`` and those it is built of."""
    inner = [getattr(value, f.name) for f in fields(value)]
    return [value, *(t for each in inner if is_dataclass(each) for t in tables_of(each))]


CHECKED = (int, float, bool)
OPTIONS = [
    (type(table), f.name, get_type_hints(type(table))[f.name])
    for table in tables_of(Settings())
    for f in fields(table)
    if type(table) is not Settings
    and (
        get_origin(get_type_hints(type(table))[f.name]) is Literal
        or get_type_hints(type(table))[f.name] in CHECKED
    )
]


@pytest.mark.parametrize(("table", "name", "hint"), OPTIONS)
def test_every_number_is_bounded_and_every_choice_is_one_of_its_literal(table, name, hint):
    if get_origin(hint) is Literal:
        assert getattr(table(), name) in get_args(hint)
        with pytest.raises(ConfigError, match="must be one of"):
            table(**{name: "no such thing"})
    elif hint in (int, float):
        absurd = (10**30, -(10**30)) if hint is int else (1e300, -1e300, math.inf, math.nan)
        for value in absurd:
            with pytest.raises(ConfigError, match=name.rstrip("_")):
                table(**{name: value})
        with pytest.raises(ConfigError, match=name.rstrip("_")):
            table(**{name: "many"})
    else:
        assert hint is bool
        with pytest.raises(ConfigError, match="true or false"):
            table(**{name: "no"})


def test_names_of_older_files_are_read_as_those_of_today():
    old = {"spare": "time", "planning": {"bend": "silhouette"}, "alignment": {"when": "closed"}}
    read = build_settings([old]).config
    assert read.optimize_for == "speed"
    assert read.planning.corner_model == "silhouette"
    assert read.alignment.mode == "loop_closure"


@dataclass(frozen=True)
class Taste:
    """Options of each kind that a word can state."""

    share: float = number(0.5)
    count: int = number(3, 1, 9)
    careful: bool = False
    name: str = ""
    way: Literal["left", "right"] = "left"


def test_options_are_parsed_from_words_by_their_types():
    words = ["share=0.25", "count=4", "careful=true", "name=a=b", "way=right"]
    assert parse_options(Taste, words, "taste") == Taste(0.25, 4, True, "a=b", "right")
    assert parse_options(Taste, [], "taste") == Taste()


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("share", "an option is NAME=VALUE, got 'share'"),
        ("speed=1", "no option of taste 'speed'; known: careful, count"),
        ("share=much", "taste.share must be a number, got 'much'"),
        ("share=2", "taste.share must be <= 1, got 2"),
        ("count=4.5", "taste.count must be a whole number, got '4.5'"),
        ("careful=yes", "taste.careful must be true or false, got 'yes'"),
        ("way=up", "taste.way must be one of left, right"),
    ],
)
def test_a_word_that_is_no_option_says_what_would_be(word, message):
    with pytest.raises(ConfigError, match=message):
        parse_options(Taste, [word], "taste")


def test_numbers_of_numpy_are_numbers():
    config = Config(max_views=np.int64(3), motion=MotionConfig(speed=np.float32(0.25)))
    assert type(config.max_views) is int
    assert (config.max_views, config.motion.speed) == (3, 0.25)
    with pytest.raises(ConfigError, match="max_views must be a whole number"):
        Config(max_views=np.bool_(True))


def test_a_configuration_shows_only_what_differs_from_the_default():
    assert repr(Config()) == "Config()"
    changed = Config.preset("best", max_views=2, planning={"lambda": 0.1})
    assert repr(changed) == "Config(max_views=2, planning=PlanningConfig(lambda_=0.1))"


def test_a_preset_takes_sections_as_mappings_and_refuses_unknown_options():
    config = Config.preset("paper", planning={"epsilon": 0.005})
    assert config.planning == replace(Config.preset("paper").planning, epsilon=0.005)
    with pytest.raises(UnknownNameError, match="epsilon"):
        Config.preset("best", planning={"epsilom": 0.005})
    with pytest.raises(ConfigError, match="no section plans"):
        Config.preset("best", plans={"epsilon": 0.005})
