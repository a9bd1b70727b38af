"""The way of samples to their subscribers."""
