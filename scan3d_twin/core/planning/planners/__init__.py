"""The built-in planners, one file each, registered by name in ``core.planning``."""
