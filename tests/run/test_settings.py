import tomllib
from dataclasses import replace

import pytest
from paper import paper_config, paper_planning

from scan3d_twin.core.errors import ConfigError, FileError
from scan3d_twin.run.settings import (
    RunConfig,
    Settings,
    build_settings,
    merge_options,
    read_settings,
    settings_toml,
)


def test_later_sources_win_key_by_key():
    merged = merge_options([{"a": {"x": 1, "y": 1}, "b": 1}, {"a": {"y": 2}}, {"b": 3}])
    assert merged == {"a": {"x": 1, "y": 2}, "b": 3}


def test_nothing_stated_gives_the_defaults():
    assert build_settings([]) == Settings()


def test_written_settings_read_back_as_they_were(tmp_path):
    planning = replace(paper_planning(), lambda_=0.05, trials=8, epsilon=0.0125)
    before = Settings(
        run=RunConfig(scene="sine_box", seed=3, target="0.5,-1"),
        config=paper_config(tour="full", max_views=4, planning=planning),
    )
    path = tmp_path / "config.toml"
    path.write_text(settings_toml(before), encoding="utf-8")
    assert build_settings([read_settings(path)]) == before


def test_a_reserved_word_is_written_without_its_underscore():
    assert "lambda" in tomllib.loads(settings_toml(Settings()))["planning"]


def test_an_unknown_key_is_named_with_the_nearest_and_the_known_ones():
    with pytest.raises(
        ConfigError, match=r"planning\.trails; did you mean planning\.trials"
    ) as info:
        build_settings([{"planning": {"trails": 3}}])
    assert "quantile" in str(info.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"plannning": {}}, "no key plannning; did you mean planning"),
        ({"planning": 3}, "planning must be a table, got 3"),
        ({"max_views": "three"}, "max_views must be a whole number, got 'three'"),
        ({"max_views": True}, "max_views must be a whole number, got True"),
        ({"max_views": 2.5}, "max_views must be a whole number, got 2.5"),
        ({"planning": {"epsilon": "10 mm"}}, "planning.epsilon must be a number, got '10 mm'"),
        ({"tour": "back"}, "tour must be one of front, full; got 'back'"),
        ({"run": {"seed": -1}}, "run.seed must be >= 0, got -1"),
        ({"run": {"mesh_scale": 0.0}}, "run.mesh_scale must be > 0, got 0"),
    ],
)
def test_a_wrong_value_is_refused_with_its_key(options, words):
    with pytest.raises(ConfigError, match=words):
        build_settings([options])


def test_a_whole_number_is_a_number():
    assert build_settings([{"planning": {"standoff": 1}}]).config.planning.standoff == 1.0


def test_a_missing_file_is_a_file_error(tmp_path):
    with pytest.raises(FileError, match="cannot read"):
        read_settings(tmp_path / "none.toml")


def test_a_file_that_is_not_toml_is_a_file_error(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_bytes(b"tour = front")
    with pytest.raises(FileError, match="not valid TOML"):
        read_settings(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(FileError, match="not valid TOML"):
        read_settings(path)
