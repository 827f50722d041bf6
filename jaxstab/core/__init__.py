"""Parts without mechanics: grids, loops, derivatives, programs, results."""
