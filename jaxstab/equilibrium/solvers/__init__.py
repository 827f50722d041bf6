"""The solvers of equilibria, a file for each."""
