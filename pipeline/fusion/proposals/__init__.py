"""Objects proposed by 2D boxes, and clusters parted by them."""
