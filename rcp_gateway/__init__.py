"""The running gateway: every part built once, started and stopped; the interface of what connects clients."""
