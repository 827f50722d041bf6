"""What knows nothing of mechanics: grids, loops, derivatives, programs, results."""
