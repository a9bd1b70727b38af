"""The composition root: builds every part once, runs the gateway, and takes it down again."""
