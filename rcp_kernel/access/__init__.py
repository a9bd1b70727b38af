"""Who asks, and what they may do: proofs of identity, rules and their conditions."""
