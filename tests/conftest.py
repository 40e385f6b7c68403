"""Fixtures that all tests share."""

from __future__ import annotations

from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
SHARED = REPOSITORY.parent / "shared" / "scenes"


@pytest.fixture(scope="session")
def shared_scenes() -> Path:
    """The folder of scenes and data that others made; it lies beside the repository."""
    if not SHARED.is_dir():
        pytest.skip("the shared scenes are not here: ../shared/scenes")
    return SHARED
