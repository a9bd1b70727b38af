"""Each kind of request, from the message of a client to its final reply and its record."""
