"""A fixed-wing aircraft."""
