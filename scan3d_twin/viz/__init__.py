"""Views of a run: top view, report page, live view, recorded sessions."""
