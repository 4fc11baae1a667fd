"""What ``twin doctor`` says about lidars that turn all round, in virtual time."""

from __future__ import annotations

import pytest
from round_scene import RoundScene
from virtual import VirtualClock

from scan3d_twin.cli.checks import check_lidar
from scan3d_twin.devices.device import Finding
from scan3d_twin.devices.ldrobot.device import STL27L
from scan3d_twin.devices.ldrobot.emulator import LdEmulator
from scan3d_twin.devices.ldrobot.model import STL27L as MODEL
from scan3d_twin.devices.links.line_model import Faults, Line, Wire


def examine(monkeypatch: pytest.MonkeyPatch, flips: float) -> dict[str, Finding]:
    """Return the findings about an STL27L on a line that flips a share of the bytes."""
    clock = VirtualClock()
    scene = RoundScene(clock, MODEL.spec, MODEL.sample_rate)
    line = Line(LdEmulator(scene, MODEL), Faults(flip=flips))
    monkeypatch.setattr(
        "scan3d_twin.devices.links.transport.SerialTransport", lambda port: Wire(line, clock)
    )
    return {finding.what: finding for finding in check_lidar(STL27L, "/dev/lidar", clock)}


def test_damage_is_judged_by_the_bytes_not_by_the_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    # 170000 bytes in 20 lines: four of them damaged are a good cable, a hundred are not
    good = examine(monkeypatch, flips=2.5e-5)["lidar rate"]
    assert good.ok
    assert int(good.found.split()[4]) > 2
    bad = examine(monkeypatch, flips=6e-4)["lidar rate"]
    assert not bad.ok
    assert bad.cure.startswith("check the cable")


def test_spare_places_of_a_line_are_no_beams(monkeypatch: pytest.MonkeyPatch) -> None:
    # Nothing returns from 0.2 rad of the circle
    assert examine(monkeypatch, flips=0.0)["lidar view"].found.startswith("97% of the beams")
