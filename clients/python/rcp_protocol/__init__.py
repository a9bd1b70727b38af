"""The contract between a gateway and its clients: envelopes, values, types, the model and the errors."""
