"""The surface a planner knows of: patches and voxels, what is seen of it and what is predicted."""
