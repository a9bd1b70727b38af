"""What keeps robots from doing harm: dead-man, e-stop, leases, envelopes and fences."""
