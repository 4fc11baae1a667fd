"""The target over a whole session: what one view joins to it, earlier views may show as well.

Of a U, the first views show one arm, and the other one beyond a gap, where it touches nothing that
is known of the target. Once a view shows what lies in between, both are of one thing.
"""

from __future__ import annotations

from dataclasses import replace

from scan3d_twin.core.config import TargetConfig
from scan3d_twin.core.scanning.target.extraction import extract_target
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import FloatArray


def extend_targets(session: Session) -> Session:
    """Return ``session`` with all that its views show of the target, as its latest view joins it.

    What a view adds is known to the others only then, so that this goes on until none adds more.
    """
    if session.config.target.extraction == "everything":
        return session
    changed = {len(session.views) - 1}
    while changed:
        known, views = session.gather_known_target(), list(session.views)
        asked = [k for k in range(len(views)) if changed - {k}]
        wider = {k: _extend_target(views[k], known, session.config.target) for k in asked}
        changed = {k for k, view in wider.items() if view is not views[k]}
        for k in changed:
            views[k] = wider[k]
        session = replace(session, views=tuple(views))
    return session


def _extend_target(view: View, known: FloatArray, config: TargetConfig) -> View:
    """Return ``view`` with all that touches the ``known`` top view (n, 2) in ``world`` [m]."""
    known = view.T_world_scan.inverse().apply(known)
    target = extract_target(view.image, view.sweep, known, config)
    return replace(view, target=target) if len(target) > len(view.target) else view
