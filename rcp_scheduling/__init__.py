"""Sharing one event loop: turns for expensive work, timers by the thousand, and work done once for all who ask."""
