"""Sessions, connections and resume; the commands and quotas of a session."""
