"""The report of an experiment: statistics, comparisons, figures, tables and the page."""
