"""One gateway as one process: its command line, its life, and what it says of itself."""
