"""Stops: how they are commanded, confirmed by measurement, kept in force, and fenced off."""
