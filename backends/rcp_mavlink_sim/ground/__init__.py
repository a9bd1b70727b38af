"""A rover, and a boat, which differs in how it moves in the water."""
