"""The program `rcpctl`, also as `python -m rcp_client` where it is not on the path."""

from rcp_protocol.program import as_program, interrupt_ends

__all__ = ["main"]


def main() -> None:
    """Run `rcpctl` and exit with its status."""
    with as_program("rcpctl"):
        with interrupt_ends():
            from rcp_client.cli import main as run
        run()


if __name__ == "__main__":
    main()
