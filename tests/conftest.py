"""Settings and fixtures shared by all tests."""

import os
from pathlib import Path

# Before numba and numpy are imported: BLAS threads only cost time on matrices this small, and two numba
# threads are the fewest with which a race between tracks could show.
for _name, _value in {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": str(min(2, os.cpu_count() or 1)),
    "MPLBACKEND": "Agg",
}.items():
    os.environ.setdefault(_name, _value)

import pytest  # noqa: E402  (after the settings above)

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of recorded tracks: $JINK_DATA, else `shared/data` beside the checkout; skips without one."""
    named = os.environ.get("JINK_DATA")
    if named:
        folder = Path(named)
        # Named but absent is a mistake, and a skip would hide it.
        if not folder.is_dir():
            pytest.fail(f"data_dir: JINK_DATA must name a folder; got {named!r}. Unset it to skip.")
        return folder
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("no recorded tracks here: set JINK_DATA to their folder")
    return folder
