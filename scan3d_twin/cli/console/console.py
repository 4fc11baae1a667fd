"""What the console does: one run at a time, checks of the robot, and what is made of earlier runs.

It knows nothing of the page: a refusal is a ``TwinError``, whose one line is shown there.
"""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from scan3d_twin.cli.commands.runs import COLUMNS, format_number, list_notes
from scan3d_twin.cli.console.form import PROGRAM, build_command, chosen_scene
from scan3d_twin.cli.console.run_process import ERROR, RunProcess, RunSnapshot
from scan3d_twin.core.errors import ConfigError, FileError, TwinError
from scan3d_twin.recording.export import list_formats
from scan3d_twin.recording.overview.listing import ListedRun, list_runs
from scan3d_twin.run.folder import default_folder
from scan3d_twin.run.settings import REAL_SCENE, read_settings

MAX_NAME = 60
"""Longest part of a folder's name that comes from a scene [characters]."""
COMPARISON = "compare.html"
"""Name of the page that compares runs."""


class BusyError(TwinError):
    """The robot, or this computer, does something else now."""


@dataclass(frozen=True)
class RunEntry:
    """An earlier run as the page lists it.

    Attributes:
        name: Its folder below that of the runs; ``.`` for that itself.
        written: When its last file was written, in local time.
        cells: Its figures, in the order of ``COLUMNS``.
        notes: What is to be said of it.
        files: The files in its folder.
    """

    name: str
    written: str
    cells: tuple[str, ...]
    notes: tuple[str, ...]
    files: tuple[str, ...]


class Console:
    """Starts, steers and lists runs for one page; several requests may come at once."""

    def __init__(self, folder: Path, live_port: int) -> None:
        """Use the runs in ``folder``, and ``live_port`` for the live view of a new one."""
        self.folder = folder.absolute() if str(folder).startswith("-") else folder
        self._live_port = live_port
        self._lock, self._working = threading.Lock(), threading.Lock()
        self._run: RunProcess | None = None
        self._job: subprocess.Popen[str] | None = None
        self._is_closed = False
        self._scratch = tempfile.TemporaryDirectory(prefix="scan3d_twin-console-")

    @property
    def is_idle(self) -> bool:
        """Whether no run goes on."""
        return self._run is None or self._run.is_over

    def snapshot(self) -> RunSnapshot | None:
        """Return the present or last run; None before the first."""
        run = self._run
        return None if run is None else run.snapshot()

    def start(self, kind: str, values: Mapping[str, Any], more: str) -> None:
        """Start a run from a filled form.

        Raises:
            BusyError: Another one goes on.
            ConfigError: A value can be no option; what it means is checked by the run itself.
        """
        scene = REAL_SCENE if kind == "real" else _as_name(chosen_scene(values))
        self._begin(kind, values, more, ["--out", str(default_folder(scene, self.folder))])

    def resume(self, name: str) -> None:
        """Continue the earlier run ``name`` with its own options.

        Raises:
            BusyError: Another one goes on.
            FileError: There is no such run.
        """
        folder = self.find_run(name).folder
        run = read_settings(folder / "config.toml").get("run")
        is_real = isinstance(run, dict) and run.get("scene") == REAL_SCENE
        kind = "real" if is_real else "sim"
        self._begin(kind, {}, "", ["--resume", str(folder)])

    def _begin(self, kind: str, values: Mapping[str, Any], more: str, place: Sequence[str]) -> None:
        shown = build_command(kind, values, more, place)
        watched = ["--view", "--view-port", str(self._live_port), "--commands", "--json"]
        arguments = [*shown, *watched]
        with self._lock:
            if self._is_closed:
                raise BusyError("the console is being closed")
            if self._run is not None:
                if not self._run.is_over:
                    raise BusyError("a run goes on: wait until it has ended, or stop it")
                self._run.end()  # its live view may still be open
            if kind == "real" and self._working.locked():
                raise BusyError("this computer is still at work on another request: wait for it")
            self._run = RunProcess(arguments, shlex.join(["twin", *shown]))

    def pause(self, wanted: bool) -> None:
        """Let the run wait after its current view, or go on; errors as ``RunProcess.pause``."""
        self._present().pause(wanted)

    def stop(self) -> None:
        """Stop the wheels at once; what was scanned is saved.

        Raises:
            ConfigError: There is no run.
        """
        self._present().stop()

    def _present(self) -> RunProcess:
        if self._run is None or self._run.is_over:
            raise BusyError("no run goes on")
        return self._run

    def check(self, values: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Return the findings of ``twin doctor`` about the ports and devices of a filled form.

        Raises:
            BusyError: The robot is at work.
        """
        asked = {
            name: value
            for name, value in values.items()
            if name in ("port", "lidar_port", "robot", "lidar")
        }
        _, *stated = build_command("real", asked, "", ())
        _, out, error = self._work(["doctor", "--json", *stated])
        try:
            findings = json.loads(out)
        except ValueError:
            raise ConfigError(error or "twin doctor said nothing") from None
        return list(findings)

    def runs(self) -> list[RunEntry]:
        """Return the earlier runs, the latest first; none where the folder is not there yet."""
        if not self.folder.is_dir():
            return []
        return [self._entry(run) for run in list_runs(self.folder)]

    def _entry(self, run: ListedRun) -> RunEntry:
        written = datetime.fromtimestamp(run.written).astimezone()
        return RunEntry(
            self._name(run.folder),
            f"{written:%Y-%m-%d %H:%M}",
            tuple(format_number(run, key, form) for _, key, form in COLUMNS),
            tuple(list_notes(run)),
            tuple(_list_files(run.folder)),
        )

    def _name(self, folder: Path) -> str:
        return folder.relative_to(self.folder).as_posix()

    def find_run(self, name: str) -> ListedRun:
        """Return the earlier run ``name``.

        Raises:
            FileError: There is none.
        """
        for run in list_runs(self.folder):
            if self._name(run.folder) == name:
                return run
        raise FileError(f"no run {name!r} in {self.folder}")

    def compare(self, names: Sequence[str]) -> None:
        """Write the page that compares the runs ``names``, the first of which is the reference.

        Raises:
            TwinError: They cannot be compared.
        """
        folders = [str(self.find_run(name).folder) for name in names]
        self._succeed(["compare", *folders, "--out", str(self.comparison)])

    @property
    def comparison(self) -> Path:
        """The page that compares runs, where one was made."""
        return Path(self._scratch.name) / COMPARISON

    def export(self, name: str, kind: str) -> str:
        """Write the model of the run ``name`` as ``kind`` and return the path, below its folder.

        Raises:
            TwinError: It cannot be written.
        """
        if kind not in list_formats():
            raise ConfigError(f"no format {kind!r}; known: {', '.join(list_formats())}")
        folder = self.find_run(name).folder
        out = self._succeed(["export", str(folder), "--to", kind, "--json"])
        return ", ".join(Path(path).name for path in json.loads(out)["files"])

    def _succeed(self, arguments: Sequence[str]) -> str:
        """Return the output of ``twin`` with ``arguments``; raise its error as one of ours."""
        code, out, error = self._work(arguments)
        if code != 0:
            raise ConfigError(error or f"it ended with exit code {code}")
        return out

    def _work(self, arguments: Sequence[str]) -> tuple[int, str, str]:
        """Run ``twin`` to its end and return its exit code, output and one-line error."""
        with self._work_alone():
            process = subprocess.Popen(
                [*PROGRAM, *arguments], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                stderr=subprocess.PIPE, encoding="utf-8", errors="replace",
                start_new_session=True,
            )  # fmt: skip
            self._job = process
            out, said = process.communicate()
            self._job = None
        errors = [line for line in said.splitlines() if line.startswith(ERROR)]
        return process.returncode, out, errors[-1].removeprefix(ERROR) if errors else ""

    @contextmanager
    def _work_alone(self) -> Iterator[None]:
        """Do one thing at a time, and none beside the real robot, which needs the computer."""
        with self._lock:
            run = self._run
            if run is not None and not run.is_over and run.snapshot().kind == "real":
                raise BusyError("the robot is at work: this can wait until its run has ended")
            if self._is_closed or not self._working.acquire(blocking=False):
                raise BusyError("this computer is still at work on another request: wait for it")
        try:
            yield
        finally:
            self._working.release()

    def close(self) -> None:
        """Stop what goes on, in the orderly way, and wait until it has ended."""
        with self._lock:
            self._is_closed = True
            run, job = self._run, self._job
        if job is not None:
            job.terminate()
        if run is not None:
            run.end()
        self._scratch.cleanup()


def _list_files(folder: Path) -> list[str]:
    """Return the names of the files in ``folder``; none if it is gone."""
    try:
        return sorted(
            path.name
            for path in folder.iterdir()
            if path.is_file() and not path.is_symlink() and not path.name.startswith(".")
        )
    except OSError:
        return []


def _as_name(scene: str) -> str:
    """Return ``scene``, a name or a path, as part of a folder's name."""
    stem = re.sub(r"[^A-Za-z0-9._-]+", "-", Path(scene).stem or "scene").lstrip(".-")
    return stem[:MAX_NAME] or "scene"
