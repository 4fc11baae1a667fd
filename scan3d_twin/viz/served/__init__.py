"""What a browser shows of a run while it goes on, and of a recorded one: served pages."""
