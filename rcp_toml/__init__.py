"""TOML files of people: the lines of their keys, further files that they include, variables in their strings."""
