"""Before anything else, the tests move into a network of their own.

Property tests draw always the same cases, so that a commit passes or fails once and for all.

`pytest --hypothesis-profile=long` draws other ones every time, and many more of them (see tests/README.md).
"""

import pytest
from hypothesis import HealthCheck, settings
from tests import network_namespace

network_namespace.enter()

settings.register_profile("fixed", deadline=None, derandomize=True, max_examples=60)
settings.register_profile(
    "long", deadline=None, max_examples=3000, suppress_health_check=[HealthCheck.too_slow], print_blob=True
)
settings.load_profile("fixed")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests of cameras need the namespace: outside of it a simulated camera would answer strangers."""
    if reason := network_namespace.why_not():
        for item in items:
            if item.get_closest_marker("cameras"):
                item.add_marker(pytest.mark.skip(reason=reason))
