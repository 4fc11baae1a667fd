from dataclasses import replace

import pytest
from sessions import WALL, session_at

from scan3d_twin.api.view_saver import ViewSaver
from scan3d_twin.core.compression import is_folded
from scan3d_twin.core.config import Config
from scan3d_twin.run.settings import settings


@pytest.mark.parametrize(("spare", "folded"), [("time", False), ("memory", True)])
def test_earlier_views_are_folded_where_memory_is_to_be_spared(tmp_path, spare, folded):
    session = session_at(WALL, Config())
    view, config = session.views[0], replace(session.config, spare=spare)
    two = replace(session, config=config, views=(view, replace(view, image=replace(view.image))))
    ViewSaver(tmp_path, settings([])).on_view(two)
    assert is_folded(two.views[0].image, "ranges") is folded
    assert not is_folded(two.views[1].image, "ranges")
    assert (tmp_path / "views" / "001.npz").exists()
