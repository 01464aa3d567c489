"""3D boxes from a network: points in pillars, convolutions over the ground, centres of objects."""
