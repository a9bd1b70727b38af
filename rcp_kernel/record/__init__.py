"""What is kept: the audit with its chain, the store, and why replies wait for it."""
