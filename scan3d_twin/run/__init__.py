"""One run: its settings, the closed loop, the report and its folder."""
