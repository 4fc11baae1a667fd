"""``--world``: all errors at once, and single ones on top."""

import pytest

from scan3d_twin.cli.commands.sim import SimOptions, resolve
from scan3d_twin.core.errors import UnknownNameError
from scan3d_twin.run.settings import build_settings, read_settings, settings_toml
from scan3d_twin.sim.config import WORLDS, TwinConfig


def test_typical_is_what_nothing_stated_means():
    assert resolve(SimOptions(), {})[0].twin == TwinConfig()


@pytest.mark.parametrize("name", WORLDS)
def test_a_world_sets_all_errors(name):
    effective, _ = resolve(SimOptions(world=name, robot="create1"), {})
    assert effective.twin == TwinConfig.of(name, "create1")
    assert effective.run.world == name


def test_single_errors_win_over_the_world():
    effective, _ = resolve(SimOptions(world="harsh"), {"lidar": {"sigma": 0.001}})
    assert effective.twin.lidar.sigma == 0.001
    assert effective.twin.errors == WORLDS["harsh"][1]


def test_a_world_is_run_again_from_its_file(tmp_path):
    effective, _ = resolve(SimOptions(world="harsh"), {"errors": {"cogging": 0.01}})
    path = tmp_path / "config.toml"
    path.write_text(settings_toml(effective))
    assert resolve(SimOptions(config=path), {})[0] == effective
    assert build_settings([read_settings(path)]) == effective


def test_an_unknown_world_lists_the_known_ones():
    with pytest.raises(UnknownNameError, match="known: harsh, ideal, typical"):
        resolve(SimOptions(world="mars"), {})
