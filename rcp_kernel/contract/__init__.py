"""Definitions shared by all parts of the gateway, which depend on none of them."""
