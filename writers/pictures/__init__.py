"""Results as pictures and as a film."""
