"""Viewpoints a planner may choose from: along the contour, and of what the contour hides."""
