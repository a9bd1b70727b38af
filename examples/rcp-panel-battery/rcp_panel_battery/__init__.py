"""The files of the panel; there is no code of Python in it."""
