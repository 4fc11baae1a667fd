"""The surface a planner knows of: what is seen, predicted, hidden and covered."""
