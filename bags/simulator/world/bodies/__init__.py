"""The bodies of vehicles, cyclists and pedestrians, in rigid parts."""
