"""Results of lidcam, read back."""
