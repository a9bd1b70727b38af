"""What each kind of request does, from its envelope to its final reply."""
