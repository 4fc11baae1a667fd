"""What a session file of someone else may hold besides its views."""

import math
from dataclasses import replace

import numpy as np
import pytest
from recorded import record

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.types import Odometry, Pose2
from scan3d_twin.recording.load import (
    NoViewError,
    load_session,
    read_beginning,
    read_last_odometry,
    read_track,
)
from scan3d_twin.recording.mcap.cdr import encode_odometry
from scan3d_twin.recording.mcap.file import McapFile
from scan3d_twin.recording.mcap.recovering_reader import read_contents
from scan3d_twin.recording.mcap.rewrite import copy_record
from scan3d_twin.recording.names import ODOMETRY


def with_last_odometry(path, pose, out):
    """Write the session file ``path`` anew, with another last sample of the odometry."""
    content = list(read_contents(path))
    last = max(k for k, each in enumerate(content) if getattr(each, "topic", "") == ODOMETRY)
    sample = Odometry(content[last].nanoseconds / 1e9, pose, np.zeros((3, 3)))
    _, data = encode_odometry(sample, None)
    content[last] = replace(content[last], data=data)
    file = McapFile(out, lambda: 0.0)
    for each in content:
        copy_record(each, file)
    file.finish()
    return out


@pytest.mark.parametrize("read", [read_track, read_last_odometry])
def test_odometry_that_no_robot_has_is_refused(session, tmp_path, read):
    path = record(tmp_path, session).path
    read(with_last_odometry(path, Pose2(3.0, 4.0, 1.0), tmp_path / "right.mcap"))
    for pose in (Pose2(math.nan, 0.0, 0.0), Pose2(0.0, 1e300, 0.0), Pose2(0.0, 0.0, math.inf)):
        wrong = tmp_path / "wrong.mcap"
        wrong.unlink(missing_ok=True)
        with_last_odometry(path, pose, wrong)
        with pytest.raises(FileError, match=r"wrong\.mcap: odometry: numbers that are no meas"):
            read(wrong)


def test_a_session_that_counts_no_view_is_none(session, tmp_path):
    empty = replace(session, views=(), plans=(), stop_reason="stopped by the user")
    path = record(tmp_path, empty).path
    with pytest.raises(NoViewError, match="holds no finished view"):
        load_session(path)


def test_a_file_with_nothing_in_it_is_no_run(session, tmp_path):
    file = McapFile(tmp_path / "session.mcap", lambda: 0.0)
    file.finish()
    with pytest.raises(FileError, match="holds nothing of a run"):
        read_beginning(tmp_path)
    path = record(tmp_path / "run", replace(session, views=(), plans=())).path
    assert read_beginning(path).name == "boxes"
