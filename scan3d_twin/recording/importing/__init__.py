"""Reads 2D lines with the angles of a turning axis from scanners that are not ours."""
