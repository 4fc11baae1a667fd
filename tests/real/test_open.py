"""``open_real``: devices are named, and wrong names are refused before any port is opened."""

import os
import subprocess
from contextlib import closing, contextmanager

import pytest
from kinematic import KinematicBase
from virtual import VirtualClock
from virtual_room import TurningLidar

import scan3d_twin as s3d
from scan3d_twin.core.errors import LinkError, UnknownNameError
from scan3d_twin.devices.create.codec import Op
from scan3d_twin.devices.create.emulator import CreateEmulator
from scan3d_twin.devices.create.packets import Mode
from scan3d_twin.devices.links.line_model import Wire
from scan3d_twin.devices.links.transport import holders
from scan3d_twin.devices.registry import Devices, lidar_names
from scan3d_twin.devices.rplidar.codec import Command, encode_request
from scan3d_twin.devices.rplidar.emulator import RplidarEmulator
from scan3d_twin.devices.rplidar.model import C1
from scan3d_twin.real import robot
from scan3d_twin.real.robot import open_real


@contextmanager
def terminal():
    """Yield the path of a pseudo-terminal that this process does not hold open."""
    ours, theirs = os.openpty()
    path = os.ttyname(theirs)
    os.close(theirs)
    with closing(os.fdopen(ours, "rb")):
        yield path


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ({"base": "turtlebot"}, "no robot 'turtlebot'"),
        ({"lidar": "sick"}, "no lidar 'sick'"),
        ({"link": "wifi"}, "no lidar link 'wifi'"),
    ],
)
def test_an_unknown_name_is_refused_before_a_port_is_opened(names, words):
    with pytest.raises(UnknownNameError, match=words), s3d.open_real("nowhere", "nowhere", **names):
        pass


def test_the_named_devices_are_opened(monkeypatch):
    """The lidar's first link is taken where none is named."""
    opened = []

    def open_over(base_link, open_lidar_link, clock, devices, guard, turntable):
        opened.append(devices)
        raise LinkError("far enough")

    monkeypatch.setattr(robot, "open_over", open_over)
    with terminal() as port, terminal() as other:
        for names in ({}, {"base": "create1", "link": "115200"}):
            with pytest.raises(LinkError, match="far enough"), open_real(port, other, **names):
                pass
    assert opened == [Devices(), Devices("create1", "urg04lx", "115200")]
    assert [devices.is_base_stated for devices in opened] == [False, True]


@pytest.mark.parametrize("lidar", lidar_names())
def test_the_base_is_found_before_a_lidar_that_could_command_it_is_opened(monkeypatch, lidar):
    def identify(link, clock, base):
        raise LinkError("no base is here")

    def open_over(*_):
        raise LinkError("far enough")

    monkeypatch.setattr(robot, "identify_base", identify)
    monkeypatch.setattr(robot, "open_over", open_over)
    words = "no base is here" if lidar.startswith("rplidar") else "far enough"
    with (
        terminal() as port,
        terminal() as other,
        pytest.raises(LinkError, match=words),
        open_real(port, other, lidar=lidar),
    ):
        pass


def test_what_an_rplidar_is_asked_presses_buttons_of_a_base_and_a_lidar_is_no_base():
    clock = VirtualClock()
    base = CreateEmulator(KinematicBase())
    base.receive(bytes([Op.START, Op.SAFE]) + encode_request(Command.STOP), clock.now())
    assert base.outputs.buttons == bytes([Command.STOP])
    assert base.mode is Mode.PASSIVE
    source = TurningLidar(clock, C1, C1.modes["dense"])
    line = Wire(RplidarEmulator(source, C1), clock)
    with pytest.raises(LinkError, match="no Create answers"):
        robot.identify_base(line, clock, None)


def test_one_port_for_both_devices_is_refused_by_either_name(tmp_path):
    (tmp_path / "by-id").symlink_to("/dev/null")
    for names in (("/dev/null", "/dev/null"), ("/dev/null", str(tmp_path / "by-id"))):
        with pytest.raises(LinkError, match="port of both base and lidar"), open_real(*names):
            pass
    url = "socket://127.0.0.1:9"
    with pytest.raises(LinkError, match="port of both base and lidar"), open_real(url, url):
        pass


def test_who_reads_a_port_already_is_named_before_it_is_opened(tmp_path):
    """``cat`` takes no lock: it would go on and take its share of the bytes."""
    with terminal() as port, subprocess.Popen(["cat", port]) as cat:
        while not holders(port):
            assert cat.poll() is None
        with (
            pytest.raises(LinkError, match=rf"{port} is in use by {cat.pid} \(cat\): end it first"),
            open_real(port, "/dev/null"),
        ):
            pass
        cat.kill()
