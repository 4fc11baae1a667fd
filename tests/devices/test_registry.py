"""Devices by name: built-in ones, those of other packages, and unknown names."""

import sys
from dataclasses import replace
from importlib.metadata import EntryPoint, EntryPoints
from types import ModuleType

import pytest

from scan3d_twin import wired
from scan3d_twin.core.errors import ConfigError, HazardError, UnknownNameError
from scan3d_twin.devices import registry
from scan3d_twin.devices.registry import (
    Devices,
    base_device,
    base_names,
    lidar_device,
    lidar_names,
    turntable_device,
    turntable_names,
)
from scan3d_twin.run.settings import build_settings, device_options, world_options
from scan3d_twin.sim.config import TwinConfig


@pytest.fixture
def others(monkeypatch):
    """Another package: a good lidar, one named like a built-in one, and what cannot be used."""
    create = base_device("create2")
    package = ModuleType("others")
    package.COPY = replace(lidar_device("urg04lx"), name="copy")
    package.UNLINKED = replace(package.COPY, name="unlinked", links=())
    package.NETWORKED = replace(package.COPY, name="networked", links=("ethernet", "usb-c"))
    package.NOISY = replace(package.COPY, name="noisy", options={"lidar": {"sigma": 0.02}})
    growing = {"lidar": {"sigma_per_metre": 0.002, "latency": 0.2}}
    package.GROWING = replace(package.COPY, name="growing", options=growing)
    package.COLOURED = replace(package.COPY, name="coloured", options={"lidar": {"colour": 1}})
    package.TABLE = {"name": "table"}
    package.DRIFT = replace(create, name="drift")
    package.TILT = replace(turntable_device("xl330"), name="tilt")
    monkeypatch.setitem(sys.modules, "others", package)
    points = EntryPoints(
        [
            EntryPoint("urg04lx", "builtins:object", registry.LIDARS),
            EntryPoint("copy", "others:COPY", registry.LIDARS),
            EntryPoint("alias", "others:COPY", registry.LIDARS),
            EntryPoint("unlinked", "others:UNLINKED", registry.LIDARS),
            EntryPoint("noisy", "others:NOISY", registry.LIDARS),
            EntryPoint("growing", "others:GROWING", registry.LIDARS),
            EntryPoint("coloured", "others:COLOURED", registry.LIDARS),
            EntryPoint("networked", "others:NETWORKED", registry.LIDARS),
            EntryPoint("table", "others:TABLE", registry.LIDARS),
            EntryPoint("table", "others:TABLE", registry.BASES),
            EntryPoint("drift", "others:DRIFT", registry.BASES),
            EntryPoint("alias", "others:DRIFT", registry.BASES),
            EntryPoint("tilt", "others:TILT", registry.TURNTABLES),
            EntryPoint("alias", "others:TILT", registry.TURNTABLES),
            EntryPoint("table", "others:TABLE", registry.TURNTABLES),
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
    for name in turntable_names():
        turntable = turntable_device(name)
        assert turntable.name == turntable.spec.name == name
        assert "\n" not in turntable.summary


@pytest.mark.usefixtures("others")
def test_other_packages_add_devices_and_replace_none():
    assert {"copy", "urg04lx"} < set(lidar_names())
    assert lidar_device("copy") is sys.modules["others"].COPY
    assert type(lidar_device("urg04lx")).__name__ == "LidarDevice"
    assert "broken" in base_names()
    with pytest.raises(ConfigError, match=r"robot broken \(scan3d_twin.no_such_module:BASE\)"):
        base_device("broken")


@pytest.mark.usefixtures("others")
@pytest.mark.parametrize(
    ("find", "name", "reason"),
    [
        (lidar_device, "table", "it is no LidarDevice but {'name': 'table'}"),
        (lidar_device, "alias", "its own name is 'copy'"),
        (lidar_device, "unlinked", "it has no links"),
        (base_device, "table", "it is no BaseDevice but {'name': 'table'}"),
        (base_device, "alias", "its own name is 'drift'"),
        (base_device, "drift", "its spec's name is 'create2'"),
        (turntable_device, "table", "it is no TurntableDevice but {'name': 'table'}"),
        (turntable_device, "alias", "its own name is 'tilt'"),
        (turntable_device, "tilt", "its spec's name is 'xl330'"),
    ],
)
def test_what_is_no_device_of_its_name_is_refused(find, name, reason):
    with pytest.raises(ConfigError, match="cannot be loaded: ") as refused:
        find(name)
    assert str(refused.value).endswith(f": {reason}")


def test_case_and_separators_of_a_name_do_not_matter():
    spelled = Devices("Roomba-600", "URG_04LX")
    assert spelled == Devices("roomba600", "urg04lx")
    assert lidar_device("RPLIDAR C1") is lidar_device("rplidar_c1")
    assert TwinConfig(robot="Create 2", lidar_model="LD-06") == TwinConfig(lidar_model="ld06")


def test_an_ld06_is_an_ld19_by_another_name():
    one, other = (TwinConfig.of("typical", lidar=name) for name in ("ld06", "ld19"))
    assert replace(one, lidar_model="ld19") == other
    ld06, ld19 = lidar_device("ld06"), lidar_device("ld19")
    for field in ("links", "sensor", "bauds", "probe", "options"):
        assert getattr(ld06, field) == getattr(ld19, field)
    assert ld06.sample_rate("") == ld19.sample_rate("")


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("rplidar_a3", "ultra capsules"),
        ("RPLIDAR A3M1", "ultra capsules"),
        ("sllidar-s3", "ultra-dense capsules"),
        ("rplidar_a2m8", "no two sources"),
        ("LD14P", "its motor has to be commanded"),
        ("coin-d4", "another protocol"),
    ],
)
def test_a_lidar_whose_facts_do_not_suffice_is_refused_with_the_reason(name, reason):
    with pytest.raises(ConfigError, match=rf"no lidar '{name}': .*{reason}.*; take "):
        lidar_device(name)


def test_a_misspelt_lidar_is_no_refused_one():
    with pytest.raises(UnknownNameError, match="did you mean rplidar_a1"):
        lidar_device("rplidar_a")


@pytest.mark.usefixtures("others")
def test_the_first_link_is_the_default():
    assert Devices().link == Devices(link="usb").link == TwinConfig().lidar_link == "usb"
    assert Devices(lidar="networked").link == "ethernet"
    assert TwinConfig(lidar_model="networked").lidar_link == "ethernet"
    assert build_settings([{"lidar_model": "networked"}]).twin.lidar_link == "ethernet"
    assert Devices(lidar="networked", link="usb-c").link == "usb-c"
    with pytest.raises(UnknownNameError, match=r"no lidar link 'usb'; .* ethernet, usb-c"):
        Devices(lidar="networked", link="usb")


@pytest.mark.usefixtures("others")
@pytest.mark.parametrize("world", ["ideal", "typical", "harsh"])
def test_a_twin_in_python_has_the_errors_that_its_devices_state(world):
    twin = TwinConfig.of(world, lidar="noisy")
    assert (twin.lidar_model, twin.lidar_link) == ("noisy", "usb")
    named = device_options(twin.devices), world_options(world), {"lidar_model": "noisy"}
    assert twin == build_settings(named).twin
    assert (twin.lidar.sigma == 0.02) == (world == "typical")


@pytest.mark.usefixtures("others")
@pytest.mark.parametrize("world", ["ideal", "typical", "harsh"])
def test_the_ideal_world_has_no_error_that_only_some_devices_have(world):
    """The URG-04LX has none that grows with distance, so that no world speaks of it."""
    twin = TwinConfig.of(world, lidar="growing")
    assert twin.lidar.latency == 0.2
    assert twin.lidar.sigma_per_metre == (0.0 if world == "ideal" else 0.002)
    named = device_options(twin.devices), world_options(world), {"lidar_model": "growing"}
    assert twin == build_settings(named).twin


@pytest.mark.usefixtures("others")
def test_an_option_that_there_is_not_is_refused():
    with pytest.raises(UnknownNameError, match=r"no option 'lidar\.colour'; known: .*sigma"):
        TwinConfig.of("typical", lidar="coloured")


def test_the_device_says_which_links_are_usb(monkeypatch):
    wirings = []

    def emulate(lidar, wiring):
        wirings.append(wiring.usb)
        raise HazardError("seen enough")

    for usb_links in (), ("usb",), ("other",):
        device = replace(lidar_device("urg04lx"), emulate=emulate, usb_links=usb_links)
        monkeypatch.setattr(wired, "lidar_device", lambda name, device=device: device)
        with pytest.raises(HazardError), wired.open_wired("plain_wall", 0):
            pass
    assert wirings == [False, True, False]


def test_what_nobody_knows_lists_what_is_known():
    with pytest.raises(UnknownNameError, match=r"no lidar 'sick'; known: .*urg04lx"):
        lidar_device("sick")
    with pytest.raises(UnknownNameError, match=r"no turntable 'mx28'; known: .*xl330"):
        turntable_device("mx28")
    with pytest.raises(UnknownNameError, match="no robot 'turtlebot'; known: create1, create2"):
        Devices(base="turtlebot")
    with pytest.raises(UnknownNameError, match="no lidar link 'wifi'; known: 115200, "):
        Devices(link="wifi")
