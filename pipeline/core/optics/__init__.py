"""How lenses bend what cameras see."""
