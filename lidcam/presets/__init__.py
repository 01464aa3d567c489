"""Settings and rigs that travel with lidcam, by name."""
