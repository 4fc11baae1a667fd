"""The command line: the only place with degrees and millimetres, prints and exit codes."""

from scan3d_twin.cli.app import main

__all__ = ["main"]
