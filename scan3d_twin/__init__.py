"""Automated 3D digitisation with a vacuum-cleaner robot and a small laser scanner."""

__version__ = "0.1.0"
