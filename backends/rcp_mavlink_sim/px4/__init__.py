"""A copter with PX4: its modes, parameters, offboard rules and messages, on the same body."""
