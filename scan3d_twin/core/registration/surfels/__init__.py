"""Surfels of a sweep: extraction, noise, and the grid in which they are found."""
