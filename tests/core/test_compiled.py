"""What numba keeps on disk is thrown away when anything it was made from has changed."""

from __future__ import annotations

import os
from pathlib import Path

from scan3d_twin.core.registration.compiled import drop_stale


def test_indices_older_than_any_module_are_dropped(tmp_path: Path) -> None:
    cache = tmp_path / "__pycache__"
    cache.mkdir()
    old, new = cache / "a.nbi", cache / "b.nbi"
    for path, stamp in ((tmp_path / "a.py", 10), (tmp_path / "b.py", 20), (old, 15), (new, 25)):
        path.touch()
        os.utime(path, (stamp, stamp))
    drop_stale(tmp_path)
    assert not old.exists()
    assert new.exists()


def test_an_index_that_another_process_has_just_dropped_is_no_error(tmp_path: Path) -> None:
    cache = tmp_path / "__pycache__"
    cache.mkdir()
    (tmp_path / "a.py").touch()
    (cache / "gone.nbi").symlink_to(tmp_path / "nowhere")
    drop_stale(tmp_path)
