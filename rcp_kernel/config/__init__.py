"""The configuration file: its tables with types and defaults, and their validation."""
