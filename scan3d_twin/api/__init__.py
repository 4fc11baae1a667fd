"""What the front door does that takes several rooms: whole runs, and saving them."""
