"""3D detection without weights: clusters of points become boxes by L-shape fitting and size priors."""
