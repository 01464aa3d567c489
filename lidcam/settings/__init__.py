"""Settings of a run: presets by name, or judged from the recording; and what each setting means."""
