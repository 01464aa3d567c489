"""Training of a network that finds objects in pillars, on simulated worlds."""
