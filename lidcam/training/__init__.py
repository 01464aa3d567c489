"""Training of the networks that lidcam brings, on simulated worlds."""
