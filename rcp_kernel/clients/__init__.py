"""Sessions, the connections they come in by, and the way out to them."""
