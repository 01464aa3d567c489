"""Sample recordings and the simulator that records them."""
