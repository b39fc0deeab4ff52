"""Property tests: always the same cases, so that a commit passes or fails once and for all.

`pytest --hypothesis-profile=long` draws other ones every time, and many more of them (see tests/README.md).
"""

from hypothesis import HealthCheck, settings

settings.register_profile("fixed", deadline=None, derandomize=True, max_examples=60)
settings.register_profile(
    "long", deadline=None, max_examples=3000, suppress_health_check=[HealthCheck.too_slow], print_blob=True
)
settings.load_profile("fixed")
