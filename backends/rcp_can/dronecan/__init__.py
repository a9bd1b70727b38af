"""DroneCAN: nodes, their transfers, and the commands that all speed controllers of a bus share.

Only buses with such nodes import this, because it needs the library `dronecan`.
"""
