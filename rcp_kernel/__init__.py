"""The kernel of the gateway: registry, sessions, rights, stops, and the extension points of plugins."""
