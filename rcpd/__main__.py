"""The program `rcpd`, also as `python -m rcpd` where it is not on the path."""

from rcp_protocol.program import as_program, interrupt_ends

__all__ = ["main"]


def main() -> None:
    """Run `rcpd` and exit with its status."""
    with as_program("rcpd"):
        with interrupt_ends():
            from rcpd.cli import main as run
        run(prog_name="rcpd")


if __name__ == "__main__":
    main()
