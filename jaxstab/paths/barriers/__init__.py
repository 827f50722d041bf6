"""Ways from one equilibrium to another at the same load, and the passes on them."""
