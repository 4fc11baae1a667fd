from dataclasses import replace

import pytest
from paper import paper_config
from sessions import WALL, session_at

from scan3d_twin.api.view_saver import ViewSaver
from scan3d_twin.core.compression import is_compressed
from scan3d_twin.run.settings import build_settings


@pytest.mark.parametrize(("resource", "compressed"), [("speed", False), ("memory", True)])
def test_earlier_views_are_compressed_to_optimize_for_memory(tmp_path, resource, compressed):
    session = session_at(WALL, paper_config())
    view, config = session.views[0], replace(session.config, optimize_for=resource)
    two = replace(session, config=config, views=(view, replace(view, image=replace(view.image))))
    ViewSaver(tmp_path, build_settings([])).on_view(two)
    assert is_compressed(two.views[0].image, "ranges") is compressed
    assert not is_compressed(two.views[1].image, "ranges")
    assert (tmp_path / "views" / "001.npz").exists()
