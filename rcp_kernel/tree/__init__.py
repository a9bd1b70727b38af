"""The tree: resources with their samples, robots' stop groups and latches."""
