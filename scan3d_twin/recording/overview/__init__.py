"""Several recorded runs: listed, and side by side."""
