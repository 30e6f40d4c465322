"""Hostile scans: a few rounds of `benchmarks/fuzz_scans.py`, and that its checks see what they should."""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType

import numpy as np
import pytest
from conftest import ROOT


@pytest.fixture(scope="module")
def fuzz() -> ModuleType:
    spec = importlib.util.spec_from_file_location("fuzz_scans", ROOT / "benchmarks" / "fuzz_scans.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["fuzz_scans"] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("number", range(12))
def test_nothing_breaks(fuzz, number):
    scans, broken = fuzz.play(number, 7)
    assert scans >= 1 and broken == []


def test_checks_see_broken_covariances_ids_and_scans(fuzz):
    good = np.array([[[2.0, 0.5], [0.5, 1.0]]])
    assert fuzz.covariances_hold(good)
    for spoilt in ([[2.0, 0.5], [0.4, 1.0]], [[1.0, 2.0], [2.0, 1.0]], [[np.nan, 0.0], [0.0, 1.0]]):
        assert not fuzz.covariances_hold(np.array([spoilt]))
    assert fuzz._ids(np.array([0, 0]), np.array([1, 2]), 3, 3) == []
    assert fuzz._ids(np.array([0, 0]), np.array([1, 1]), 3, 2) == ["ids repeat", "scans missing"]
