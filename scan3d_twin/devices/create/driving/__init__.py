"""Parts of the driver: receiving, heartbeat, inquiries and watches."""
