"""Results as images and as a film."""
