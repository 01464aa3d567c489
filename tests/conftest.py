"""What holds for all tests: no deadlines, since the machine may be busy with other tests."""

from hypothesis import settings

settings.register_profile("lidcam", deadline=None)
settings.load_profile("lidcam")
