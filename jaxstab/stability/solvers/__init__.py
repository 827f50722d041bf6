"""The eigensolvers, a file for each."""
