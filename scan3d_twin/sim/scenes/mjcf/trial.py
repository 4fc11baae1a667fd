"""A trial of a scene file in a process of its own, before it is read here.

MuJoCo's parser has no limits: a few lines can ask for a billion bodies, and where memory ends it
aborts the process. So a file from elsewhere is first read and compiled by a child with limits of
memory and processor time. The memory that the file itself asks for does not count, as it is not
taken (``settings.py``): dm_control's rodent wants 3.4 GB for its contacts.
"""

from __future__ import annotations

import re
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from scan3d_twin.core.errors import SceneError
from scan3d_twin.limits import how_to_raise, limit_factor, scaled
from scan3d_twin.sim.scenes.mjcf.settings import SIZES

MAX_FILE = 32_000_000
"""Largest scene file [bytes]: a binary STL of 640,000 triangles, which take 0.8 GB and 4 s."""
MAX_MEMORY = 900_000_000
"""Memory for reading a file [bytes]; the largest mesh file that is admitted takes 0.7 GB."""
COPIES = 4
"""How many times as much memory a scene may take while it is built, of which it is copied and
compiled as many times: near the limit even Python's own modules would fail to load."""
MAX_TIME = 3.0
"""Processor time of the trial [s]; menageries of robots take one."""
_HARMLESS = frozenset(
    b"mujoco compiler option flag visual headlight map rgba statistic default worldbody body geom "
    b"site light camera joint freejoint inertial custom text tuple element asset material contact "
    b"exclude pair".split()
)
"""Elements that take no more memory than their text, several times over."""
_ELEMENT = re.compile(rb"<\s*([A-Za-z_][\w.-]*)")
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_CHILD = """
import resource, sys
path, memory, seconds = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
import mujoco
used = resource.getrusage(resource.RUSAGE_SELF)
pages = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (pages + memory, pages + memory))
limit = int(used.ru_utime + used.ru_stime + seconds) + 1
resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
log = mujoco.MjLogConfig.get()
log.logto_file = False
log.set()
try:
    spec, fresh = mujoco.MjSpec.from_file(path), mujoco.MjSpec()
    for name in sys.argv[4:]:
        setattr(spec, name, getattr(fresh, name))
    spec.compile()
except (MemoryError, RuntimeError):
    sys.exit(12)
except Exception as error:  # an error in the scene is reported by the reading that follows
    sys.exit(12 if "allocate memory" in str(error) else 0)
"""
_OUT_OF_MEMORY = 12


def check_size(path: Path) -> None:
    """Check that a scene file is not too large.

    Raises:
        SceneError: It is.
    """
    try:
        size = path.stat().st_size
    except OSError as error:
        raise SceneError(f"cannot read {path}: {error.strerror or error}") from None
    if size > scaled(MAX_FILE):
        raise SceneError(
            f"{path} has {size / 1e6:.0f} MB, more than {scaled(MAX_FILE) / 1e6:.0f}: simplify its "
            f"meshes; or {how_to_raise()}"
        )


@contextmanager
def limited_memory(path: Path, times: int = 1) -> Iterator[None]:
    """Let this process take only so much more memory while it reads the file ``path``.

    Args:
        path: The file.
        times: How many times ``MAX_MEMORY`` it may take.

    Raises:
        SceneError: The file takes more.
    """
    before = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * resource.getpagesize() + times * scaled(MAX_MEMORY)
    if before[0] != resource.RLIM_INFINITY:
        limit = min(limit, before[0])
    try:
        resource.setrlimit(resource.RLIMIT_AS, (limit, before[1]))
        yield
    except MemoryError:
        raise _too_large(path) from None
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def _too_large(path: Path) -> SceneError:
    return SceneError(
        f"{path} takes more than {scaled(MAX_MEMORY) / 1e9:g} GB to read, or breaks the parser; "
        f"{how_to_raise()}"
    )


def try_mjcf(path: Path) -> None:
    """Read and compile the MJCF file ``path`` in a child, if it may expand.

    Raises:
        SceneError: It takes too much memory or time, or ends the parser.
    """
    # Accept what cannot expand
    check_size(path)
    try:
        text = path.read_bytes()
    except OSError as error:
        raise SceneError(f"cannot read {path}: {error.strerror or error}") from None
    try:
        _COMMENT.sub(b"", text).decode("utf-8")
    except UnicodeDecodeError as error:
        raise SceneError(f"{path} is not valid MJCF: {error}; save it as UTF-8") from None
    if set(_ELEMENT.findall(text)) <= _HARMLESS:
        return

    # Run the trial
    seconds = MAX_TIME * limit_factor()
    limits = str(scaled(MAX_MEMORY)), f"{seconds}"
    command = [sys.executable, "-P", "-c", _CHILD, str(path), *limits, *SIZES]
    try:
        code = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=None,
            check=False,
        ).returncode
    except OSError as error:
        raise SceneError(f"cannot try {path}: {error.strerror or error}") from None

    # Name what went wrong
    if code in (-signal.SIGXCPU, -signal.SIGKILL):
        raise SceneError(f"{path} takes longer than {seconds:g} s to read; {how_to_raise()}")
    if code == _OUT_OF_MEMORY or code < 0:
        raise _too_large(path)
