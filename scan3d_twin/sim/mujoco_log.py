"""MuJoCo's own log: a scene that warns leaves no file behind."""

from __future__ import annotations

import mujoco

DEFAULT_FILE = "MUJOCO_LOG.TXT"
"""Where MuJoCo 4.0 writes warnings unless told otherwise: in the working directory, whatever it
is (chapter "Default handler" of its documentation)."""


def write_no_log_file() -> None:
    """Keep MuJoCo's warnings on the standard error, out of the working directory.

    The setting belongs to the process, so a file that the caller chose is left as it is.
    """
    config = mujoco.MjLogConfig.get()
    if config.logto_file and config.logfile == DEFAULT_FILE:
        config.logto_file = False
        config.set()
