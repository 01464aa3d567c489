"""What moves: vehicles, cyclists and pedestrians, in rigid parts."""
