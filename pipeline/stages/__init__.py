"""The stages of a frame, one module each."""
