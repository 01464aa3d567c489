"""3D boxes by a network: points in pillars, convolutions over the ground, centres of objects."""
