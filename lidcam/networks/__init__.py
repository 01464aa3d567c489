"""2D networks that are known by name, and brought on request."""
