"""``open_real``: devices are named, and wrong names are refused before any port is opened."""

import os
from contextlib import closing

import pytest

import scan3d_twin as s3d
from scan3d_twin.core.errors import LinkError, UnknownNameError
from scan3d_twin.devices.registry import Devices
from scan3d_twin.real import robot
from scan3d_twin.real.robot import open_real


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ({"base": "roomba"}, "no robot 'roomba'"),
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

    def open_over(base_link, open_lidar_link, clock, devices, guard):
        opened.append(devices)
        raise LinkError("far enough")

    monkeypatch.setattr(robot, "open_over", open_over)
    ours, theirs = os.openpty()
    with closing(os.fdopen(ours, "rb")), closing(os.fdopen(theirs, "rb")):
        port = os.ttyname(theirs)
        for names in ({}, {"base": "create1", "link": "115200"}):
            with pytest.raises(LinkError, match="far enough"), open_real(port, port, **names):
                pass
    assert opened == [Devices(), Devices("create1", "urg04lx", "115200")]
