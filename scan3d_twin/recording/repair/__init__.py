"""Damaged and unwanted parts of a session: recovered, and taken out."""
