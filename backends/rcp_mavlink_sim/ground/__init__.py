"""A rover, and a boat that differs from it in how it lies in its water."""
