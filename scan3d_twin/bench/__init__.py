"""Experiments: many closed loops in the twin, planners against planners on the same seeds."""
