"""Registration of point clouds."""
