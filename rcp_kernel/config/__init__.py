"""The configuration file: its tables, their types and defaults, and what is wrong with one."""
