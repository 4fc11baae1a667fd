"""Pictures of the gallery: the SVG files that an example leaves in the folder it is given."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

from sphinx_gallery.scrapers import figure_rst

FOLDER = Path(tempfile.mkdtemp(prefix="scan3d_twin-gallery-"))


def run_arguments(gallery_conf: dict[str, Any], script_vars: dict[str, Any]) -> list[str]:
    """Return the arguments of an example: a new folder that it may write to."""
    folder = FOLDER / Path(script_vars["src_file"]).stem
    folder.mkdir(exist_ok=True)
    return [str(folder)]


def collect_pictures(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Return the reStructuredText that shows the SVG files written since the last block."""
    folder = FOLDER / Path(block_vars["src_file"]).stem
    shown = block_vars.setdefault("pictures_shown", set())
    names = []
    for path in sorted(set(folder.rglob("*.svg")) - shown):
        target = Path(next(block_vars["image_path_iterator"])).with_suffix(".svg")
        shutil.copyfile(path, target)
        names.append(str(target))
        shown.add(path)
    return figure_rst(names, gallery_conf["src_dir"])
