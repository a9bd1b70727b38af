"""A quadrotor."""
