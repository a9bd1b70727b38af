"""`rcpctl`, behind its command line."""
