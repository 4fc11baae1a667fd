"""What an experiment shows: statistics, comparisons, figures, tables and the page."""
