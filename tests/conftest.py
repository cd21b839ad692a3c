"""Where the recordings of real arms are."""

from __future__ import annotations

import os
from pathlib import Path

import hypothesis
import pytest

hypothesis.settings.register_profile("excitant", deadline=None, derandomize=True, max_examples=25)
hypothesis.settings.load_profile("excitant")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Recordings of real arms: required in continuous integration, else skipped without them."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("EXCITANT_DATA", beside))
    if not folder.is_dir():
        reason = f"no recordings of real arms in {folder}; set EXCITANT_DATA"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    return folder
