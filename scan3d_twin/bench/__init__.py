"""Experiments of ``twin bench``: many closed loops in the twin, planners on the same seeds."""
