"""Poses of the views: scan matching of a new view, loop closure and the pose graph."""
