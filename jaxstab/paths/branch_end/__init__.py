"""Branches of equilibria: how they follow the load, where they end, and why."""
