"""`python -m rcpd`, where the program is not on the path."""

from rcpd.cli import main

main(prog_name="rcpd")
