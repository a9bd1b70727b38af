"""From a sample to its subscribers, and what waits for them."""
