"""Sessions, connections and resume; a session's commands, and what counts them."""
