"""The variables ``TWIN_*``: each option that can be saved may also be set in the environment."""

PREFIX = "TWIN_"
