"""An MCAP file written during the run; a crash loses at most the messages since the last flush."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from mcap.well_known import MessageEncoding, Profile, SchemaEncoding

from scan3d_twin import __version__
from scan3d_twin.core.errors import FileError
from scan3d_twin.recording.mcap import ros_messages as ros
from scan3d_twin.recording.mcap.writer import McapWriter

FLUSH_PERIOD = 0.5
"""Longest time between two flushes, on the robot's clock and on the computer's [s]."""
CHUNK_SIZE = 256 * 1024
"""Size at which a chunk is flushed [bytes]: half a second of lines and raw bytes is less."""
_FOREVER = "{sec: 9223372036, nsec: 854775807}"
LATCHED = f"""- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline: {_FOREVER}
  lifespan: {_FOREVER}
  liveliness: 1
  liveliness_lease_duration: {_FOREVER}
  avoid_ros_namespace_conventions: false
"""
"""Quality of service of a message that late subscribers need too, as rosbag2 writes it (durability
1 is transient_local)."""


class RecordingError(FileError):
    """A session file cannot be written to: the disk is full or gone."""

    def __init__(self, path: Path, error: OSError) -> None:
        self._cause = f"cannot record to {path}: {error.strerror or error}"
        super().__init__(
            f"{self._cause}; earlier data is kept: free disk space and continue with --resume"
        )

    def before_first_view(self) -> FileError:
        """Return the error of a run without a finished view, of which nothing is kept."""
        return FileError(
            f"{self._cause}; no view was finished, so nothing is kept: free disk space and start "
            "again"
        )

    def before_change(self, path: Path) -> FileError:
        """Return the error of a change to the session file ``path``, which it has not reached."""
        return FileError(f"{self._cause}; {path} is as it was: free disk space and try again")


class Sink:
    """A file for appending: each write reaches the operating system or leaves the file as it was.

    A run in progress holds a lock on it.
    """

    def __init__(self, path: Path) -> None:
        """Create the file ``path``, which must not exist.

        Raises:
            FileError: The file cannot be created.
        """
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        except OSError as error:
            raise FileError(f"cannot write {path}: {error.strerror or error}") from error
        self._size = 0
        self._failure: FileError | None = None
        with suppress(OSError):  # some network disks know no locks
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def write(self, data: bytes) -> int:
        """Write all of ``data``.

        After a failure nothing more is written, because an index would not match the content.

        Raises:
            FileError: The disk is full or gone, now or in an earlier call; earlier data is kept.
        """
        # Refuse after a failure
        if self._failure is not None:
            raise self._failure

        # Write, or restore the size
        left = memoryview(data)
        try:
            while left:
                left = left[os.write(self._fd, left) :]
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._fd, self._size)
                os.lseek(self._fd, self._size, os.SEEK_SET)
            self._failure = RecordingError(self.path, error)
            raise self._failure from error

        # Count the bytes
        self._size += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the size of the file [bytes]."""
        return self._size

    def sync(self) -> None:
        """Wait until all data is on the disk, safe from a power cut.

        Raises:
            FileError: The disk is full or gone.
        """
        try:
            os.fsync(self._fd)
        except OSError as error:
            raise RecordingError(self.path, error) from error

    def rename(self, path: Path) -> None:
        """Rename the file to ``path``, replacing a file of that name.

        Raises:
            FileError: The file cannot be renamed.
        """
        try:
            os.replace(self.path, path)
        except OSError as error:
            raise FileError(f"cannot write {path}: {error.strerror or error}") from error
        self.path = path

    @property
    def closed(self) -> bool:
        """Whether the file is closed."""
        return self._fd < 0

    def close(self) -> None:
        """Close the file; closing twice does nothing."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class McapFile:
    """Writes ROS 2 messages; a topic is declared with its first message."""

    def __init__(self, path: Path, wall: Callable[[], float]) -> None:
        """Create the file ``path``.

        Args:
            path: Must not exist.
            wall: Returns the computer's time [s]; only differences count.

        Raises:
            FileError: The file cannot be created.
        """
        self.sink = Sink(path)
        self._wall = wall
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._flushed = (0.0, wall())
        library = f"scan3d_twin {__version__}"
        self._writer = McapWriter(self.sink, CHUNK_SIZE, Profile.ROS2, library)

    def write(
        self, topic: str, stamp: float, message: ros.Message, *, latched: bool = False
    ) -> None:
        """Add ``message`` at ``stamp`` on the robot's clock [s].

        Raises:
            FileError: The disk is full or gone.
        """
        kind, data = message
        self.write_bytes(topic, kind, round(stamp * 1e9), data, latched=latched)
        before, wall = self._flushed
        if abs(stamp - before) >= FLUSH_PERIOD or self._wall() - wall >= FLUSH_PERIOD:
            self.flush(stamp)

    def write_bytes(
        self, topic: str, name: str, nanoseconds: int, data: bytes, *, latched: bool = False
    ) -> None:
        """Add an encoded message of type ``name``."""
        if topic not in self._channels:
            self._channels[topic] = self._channel(topic, name, latched=latched)
        self._writer.add_message(self._channels[topic], nanoseconds, data)

    def metadata(self, name: str, entries: Mapping[str, str]) -> None:
        """Add ``entries`` called ``name``; readers take the last entries of a name."""
        self._writer.add_metadata(name, entries)

    def flush(self, stamp: float) -> None:
        """Hand all messages to the operating system, where they survive the end of the program."""
        self._writer.flush()
        self._flushed = (stamp, self._wall())

    def finish(self) -> None:
        """Write the index, which completes the file, and close it."""
        self._writer.finish()
        self.sink.sync()
        self.sink.close()

    def _channel(self, topic: str, name: str, *, latched: bool) -> int:
        if name not in self._schemas:
            text, _ = ros.typestore().generate_msgdef(name, ros_version=2)
            self._schemas[name] = self._writer.add_schema(name, SchemaEncoding.ROS2, text.encode())
        quality = {"offered_qos_profiles": LATCHED} if latched else {}
        return self._writer.add_channel(topic, MessageEncoding.CDR, self._schemas[name], quality)
