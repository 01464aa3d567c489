"""Training of the networks that come with lidcam, on simulated worlds."""
