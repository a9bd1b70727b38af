"""From a sample to everybody who subscribed to it."""
