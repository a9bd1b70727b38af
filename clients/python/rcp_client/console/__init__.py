"""The implementation of `rcpctl`."""
