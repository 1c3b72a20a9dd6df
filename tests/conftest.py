"""Property tests draw the same examples every time: a run that passes here passes elsewhere."""

from hypothesis import settings

settings.register_profile("same", derandomize=True, deadline=None)
settings.load_profile("same")
