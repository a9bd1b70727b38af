"""What a client, a robot and the gateway agree about, and what needs nothing of the gateway."""
