"""What moves: vehicles and people, their ways, and who drives them."""
