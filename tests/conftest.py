"""Fixtures that all tests share."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest

# A shell's background job ignores Ctrl-C, and so would the processes that tests interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Tests run side by side on the same cores, where threads that spin for work take it from others.
# NumPy's do, which multiply matrices; it is told before it is loaded, here and in tests' processes.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

REPOSITORY = Path(__file__).resolve().parent.parent
SHARED = REPOSITORY.parent / "shared" / "scenes"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="the long form of tests that have one")


def pytest_configure(config: pytest.Config) -> None:
    """Hypothesis tries the same every time, but in the long form: a test that fails was changed."""
    config.option.loadscopereorder = False  # xdist would put files of few tests last
    hypothesis.settings.register_profile("same", derandomize=True)
    if not config.getoption("--long"):
        hypothesis.settings.load_profile("same")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes minutes with --long comes first, so that no processor waits for it in the end."""
    items.sort(key=lambda item: item.path.name != "test_nvrtc.py")


@pytest.fixture(scope="session")
def long(request: pytest.FixtureRequest) -> bool:
    """Whether tests may take minutes."""
    return bool(request.config.getoption("--long"))


@pytest.fixture(scope="session")
def shared_scenes() -> Path:
    """The folder of scenes and data that others made; it lies beside the repository."""
    if not SHARED.is_dir():
        pytest.skip("the shared scenes are not here: ../shared/scenes")
    return SHARED


@pytest.fixture(autouse=True)
def _log_as_it_was() -> Iterator[None]:
    """The command line sets how much is said, for the whole process."""
    log = logging.getLogger("parhelion")
    level, handlers, propagates = log.level, list(log.handlers), log.propagate
    yield
    log.setLevel(level)
    log.handlers[:] = handlers
    log.propagate = propagates
