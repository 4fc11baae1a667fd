"""``twin calibrate lidar`` as a person calls it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from paper import paper_config, paper_sweep

from scan3d_twin.cli.app import main
from scan3d_twin.core.scanning.sweep import sweep
from scan3d_twin.recording.image import image_bytes
from scan3d_twin.recording.scans import BACK_SCAN_FILE, SCAN_FILE
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim

LATERAL, ROLL = 0.010, math.radians(1.0)


def wrong_twin() -> TwinConfig:
    """Return a twin whose lidar sits wrong on wheels that are alike, so that it does not lean."""
    twin = TwinConfig()
    errors = replace(twin.errors, wheel_radius=0.0, mount_lateral=LATERAL, mount_roll=ROLL)
    return replace(twin, errors=errors)


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a full turn and a sweep to both sides, in the living room."""
    folder = tmp_path_factory.mktemp("cal")
    for name, width, files in (
        ("turn", 360.0, (SCAN_FILE,)),
        ("back", 300.0, (SCAN_FILE, BACK_SCAN_FILE)),
    ):
        wanted = paper_sweep(width=math.radians(width), yaw_rate=math.radians(10.0))
        config = replace(paper_config(), sweep=wanted)
        (folder / name).mkdir()
        with open_sim("living_room", 0, wrong_twin()) as (robot, _):
            for file in files:
                seen = sweep(robot, 0.0, config, lambda line: None)
                (folder / name / file).write_bytes(image_bytes(seen))
    return folder


def test_it_recovers_offset_and_tilt(scans: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "lidar", str(scans), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["mount"]["lateral"] == pytest.approx(LATERAL, rel=0.10)
    assert found["mount"]["roll"] == pytest.approx(ROLL, rel=0.10)
    assert all(found["known"].values())
    assert found["standard_errors"]["lateral"] < 0.002


def test_it_says_what_to_write_into_the_configuration(
    scans: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", "lidar", str(scans / "turn")]) == 0
    out = capsys.readouterr().out
    assert "[mount]" in out
    assert "lateral = 0.0" in out
    assert "time_offset  unknown: scan in both directions" in out


def test_a_folder_without_scans_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", "lidar", str(tmp_path)]) == 3
    assert "twin scan --width 360" in capsys.readouterr().err


def test_a_file_of_something_else_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    assert main(["calibrate", "lidar", str(tmp_path)]) == 3
    assert "is no sweep of" in capsys.readouterr().err
    (tmp_path / "other.npz").write_text("not an archive")
    assert main(["calibrate", "lidar", str(tmp_path)]) == 3


def test_a_wide_scan_cannot_go_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["scan", "--scene", "plain_wall", "--width", "360", "--back"]
    assert main([*arguments, "--out", str(tmp_path / "x")]) == 2
    assert "--back needs" in capsys.readouterr().err
