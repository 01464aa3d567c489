"""Objects that a 3D detector wrote into a recording, from messages of any type that lidcam knows."""
