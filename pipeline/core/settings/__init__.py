"""Settings: one model per stage."""
