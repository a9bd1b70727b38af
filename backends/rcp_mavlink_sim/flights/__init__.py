"""What each kind of vehicle does in each mode."""
