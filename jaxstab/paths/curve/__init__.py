"""Branches of equilibria, stable or not, around their folds and active-set changes."""
