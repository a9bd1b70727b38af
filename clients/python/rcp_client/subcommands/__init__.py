"""The subcommands of `rcpctl`: what may be written on the command line."""
