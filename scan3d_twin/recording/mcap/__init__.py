"""The session file: MCAP with ROS 2 messages, written during the run, readable if cut off."""
