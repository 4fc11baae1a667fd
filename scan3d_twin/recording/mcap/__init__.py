"""The session file: MCAP with ROS 2 messages, written as the run goes, read wherever it ends."""
