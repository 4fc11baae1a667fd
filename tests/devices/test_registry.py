"""Devices by name: built-in ones, those of other packages, and unknown names."""

from importlib.metadata import EntryPoint, EntryPoints

import pytest

from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.devices import registry
from scan3d_twin.devices.registry import (
    Devices,
    base_device,
    base_names,
    lidar_device,
    lidar_names,
)


@pytest.fixture
def others(monkeypatch):
    """Another package with a lidar named like a built-in one, and a base that cannot be loaded."""
    points = EntryPoints(
        [
            EntryPoint("urg04lx", "builtins:object", registry.LIDARS),
            EntryPoint("copy", "scan3d_twin.devices.urg.device:URG04LX", registry.LIDARS),
            EntryPoint("broken", "scan3d_twin.no_such_module:BASE", registry.BASES),
        ]
    )
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: points.select(group=group))


def test_every_device_has_its_own_name_and_one_line():
    for name in lidar_names():
        device = lidar_device(name)
        assert device.name == name
        assert "\n" not in device.summary
        for link in device.links:
            assert device.spec(link).n_beams > 1
            assert 1000 * device.spec(link).min_range == pytest.approx(device.sensor.min_range_mm)
            assert 1000 * device.spec(link).max_range == pytest.approx(device.sensor.max_range_mm)
    for name in base_names():
        assert base_device(name).name == base_device(name).spec.name == name


@pytest.mark.usefixtures("others")
def test_other_packages_add_devices_and_replace_none():
    assert lidar_names() == ("copy", "urg04lx")
    assert lidar_device("copy") is lidar_device("urg04lx")
    assert "broken" in base_names()
    with pytest.raises(ConfigError, match=r"robot broken \(scan3d_twin.no_such_module:BASE\)"):
        base_device("broken")


def test_what_nobody_knows_lists_what_is_known():
    with pytest.raises(UnknownNameError, match="no lidar 'sick'; known: urg04lx"):
        lidar_device("sick")
    with pytest.raises(UnknownNameError, match="no robot 'roomba'; known: create1, create2"):
        Devices(base="roomba")
    with pytest.raises(UnknownNameError, match="no lidar link 'wifi'; known: 115200, "):
        Devices(link="wifi")
