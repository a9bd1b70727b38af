"""What survives the process: the audit log with its hash chain, and the store."""
