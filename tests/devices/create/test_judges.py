"""Third-party programs read the emulated lidar.

MRPT's rawlog-grabber is Debian's package mrpt-apps.
"""

import shutil
import subprocess
import time

import numpy as np
import pytest
from virtual import KnownLidar, VirtualClock

from scan3d_twin.devices.links.line_model import Line
from scan3d_twin.devices.links.pty import PtyPort
from scan3d_twin.devices.links.serve import serve
from scan3d_twin.devices.urg.emulated_quirks import UrgProfile
from scan3d_twin.devices.urg.emulator import UrgEmulator

pytestmark = pytest.mark.slow

SETTINGS = """
[global]
rawlog_prefix = {folder}/log
GRABBER_PERIOD_MS = 50
[lidar]
driver = CHokuyoURG
process_rate = 30
COM_port_LIN = {port}
COM_baudRate = 115200
pose_x = 0
pose_y = 0
pose_z = 0
pose_yaw = 0
pose_pitch = 0
pose_roll = 0
"""
SCANS = 4
ENOUGH = (SCANS + 2) * 2137
"""Size of that number of scans and of the handshake before them [bytes]."""
DEADLINE = 20.0
ATTEMPTS = 4
PROFILES = {
    "usb": UrgProfile(),
    # MRPT waits .1 s for an answer, which is the tick; at 19200 baud that is too short with it.
    "serial": UrgProfile(usb=False, baud=19200, scip1=True, tick=0.0),
}


@pytest.mark.skipif(
    not (shutil.which("rawlog-grabber") and shutil.which("rawlog-edit")),
    reason="needs rawlog-grabber and rawlog-edit (apt install mrpt-apps)",
)
@pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES)
def test_mrpt_reads_every_range(tmp_path, profile):
    clock = VirtualClock()
    # MRPT gives up for long when one answer is late, as it may be on a busy computer.
    tries = (
        _grab(tmp_path / str(attempt), Line(UrgEmulator(KnownLidar(clock), profile)), clock)
        for attempt in range(ATTEMPTS)
    )
    rows = next((rows for rows in tries if len(rows) >= SCANS), np.empty((0, 1365)))
    # Time, then a range and a flag for each step.
    ranges = rows[:, 1:683]
    assert ranges.shape == (len(rows), 682)
    assert len(rows) >= SCANS
    truths = np.array([KnownLidar.values(turn) for turn in range(int(10 * clock.now()) + 1)])
    for row in ranges:
        heard = np.round(1000 * row)
        matches = [((heard == truth) | (truth < 20)).sum() for truth in truths]
        assert max(matches) == 682


def _grab(folder, line, clock):
    """Let rawlog-grabber read the lidar on ``line``; return what it saved, a row per scan."""
    folder.mkdir()
    port = PtyPort(line)
    (folder / "grab.ini").write_text(SETTINGS.format(folder=folder, port=port.path))
    deadline = time.monotonic() + DEADLINE
    with (
        (folder / "out.txt").open("w") as out,
        subprocess.Popen(
            ["rawlog-grabber", str(folder / "grab.ini")], stdin=subprocess.PIPE, stdout=out
        ) as grabber,
    ):
        serve([port], clock, lambda: line.passed > ENOUGH or time.monotonic() > deadline)
        grabber.stdin.write(b"\x1b")
        grabber.stdin.flush()
        stop = time.monotonic() + 5.0
        serve([port], clock, lambda: grabber.poll() is not None or time.monotonic() > stop)
        grabber.kill()
    port.close()
    for rawlog in folder.glob("*.rawlog"):
        command = ["rawlog-edit", "--export-2d-scans-txt", "-i", rawlog.name]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
    tables = [np.loadtxt(table, comments="%", ndmin=2) for table in folder.glob("*Hokuyo.txt")]
    return tables[0] if tables else ()
