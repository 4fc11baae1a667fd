"""Pages in a file of their own: reports and comparisons, with charts and models."""
