"""Each kind of request, from its envelope to its final reply and its record."""
