"""Settings that all tests share."""

from __future__ import annotations

from hypothesis import settings

# Times of single examples say nothing on a busy machine with two workers; what must be fast has a test of its own.
settings.register_profile("dashpot", deadline=None)
settings.load_profile("dashpot")
