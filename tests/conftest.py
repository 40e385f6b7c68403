"""Fixtures that all tests share."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

# A shell's background job ignores Ctrl-C, and so would the processes that tests interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

REPOSITORY = Path(__file__).resolve().parent.parent
SHARED = REPOSITORY.parent / "shared" / "scenes"


@pytest.fixture(scope="session")
def shared_scenes() -> Path:
    """The folder of scenes and data that others made; it lies beside the repository."""
    if not SHARED.is_dir():
        pytest.skip("the shared scenes are not here: ../shared/scenes")
    return SHARED
