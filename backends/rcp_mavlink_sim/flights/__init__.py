"""The modes of each kind of vehicle."""
