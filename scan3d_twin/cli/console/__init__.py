"""The console: one page on which runs are started, steered, compared and exported."""
