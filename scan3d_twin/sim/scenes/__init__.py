"""Scenes: MJCF files, meshes and random scenes, their surfaces and pictures."""
