"""Property tests draw the same examples every time: a run that passes here passes elsewhere."""

from hypothesis import settings

import app.bench  # noqa: F401  (before MuJoCo, whose graphics it chooses)

settings.register_profile("same", derandomize=True, deadline=None)
settings.load_profile("same")
