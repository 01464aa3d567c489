"""How probable it is that something is an object: what the sensors say and do not say, weighed."""
