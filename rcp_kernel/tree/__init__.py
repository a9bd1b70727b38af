"""The tree: resources with their samples, robot units (what a stop stops as a whole) and latches."""
