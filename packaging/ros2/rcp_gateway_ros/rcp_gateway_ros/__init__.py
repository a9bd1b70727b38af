"""A package without code: see `launch/gateway.launch.py`."""
