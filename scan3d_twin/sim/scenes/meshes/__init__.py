"""Scenes of mesh files: read as they are meant, cleaned, and put into a room."""
