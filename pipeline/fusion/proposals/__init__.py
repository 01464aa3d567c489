"""Objects proposed by 2D boxes, and clusters split by them."""
