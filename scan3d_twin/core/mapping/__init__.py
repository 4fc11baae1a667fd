"""Where the views lie: scan matching of a new view, loop closure and the pose graph."""
