"""The kernel of the RCP gateway: registry, sessions, rules, commands, streams and status."""
