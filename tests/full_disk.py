"""Test helper: a disk that takes no more, for all that writes files, libraries in C included."""

import resource
from contextlib import contextmanager


@contextmanager
def full_disk(room):
    """Let no file grow beyond ``room`` [bytes]; writing more fails, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
