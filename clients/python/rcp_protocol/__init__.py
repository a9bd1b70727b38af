"""The protocol shared by gateway and clients: envelopes, values, types, model, errors."""
