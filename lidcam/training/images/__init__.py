"""Training of a network that finds objects in simulated images."""
