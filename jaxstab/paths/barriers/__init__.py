"""Minimum-energy paths between equilibria at one load, and the saddle points (passes) on them."""
