"""The way of samples to subscribers, and the data queued for them."""
