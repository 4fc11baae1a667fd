"""The planners, one file each; each is registered by its name in ``core.planning``."""
