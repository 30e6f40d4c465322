"""A first compilation shared with a second process: it compiles what runs need, delays nothing else, and may fail."""

import subprocess
import sys

import numba
import pytest
from numba.core import config

from jink.envs.scenarios import make_scenario
from jink.estimators.adaptive_cycle import advance
from jink.training.console import name_what_compiles
from jink.training.ladder import warming
from jink.training.ladder.rungs import LADDER, make_follower
from jink.training.ladder.settings import Settings
from jink.training.ladder.typical import EVALUATION_SEED, simulate_runs


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
@pytest.mark.parametrize("name", warming.LEARNING)
def test_the_second_process_compiles_what_a_run_uses(name):
    """One signature, whatever the estimator: else the command would compile its own and the other's be of no use."""
    assert name in LADDER
    scenario = make_scenario("surge-v0")
    make_follower(name, scenario, Settings()).estimate(simulate_runs(scenario, 1, EVALUATION_SEED))
    assert advance.signatures == [warming.learning_signature()]


def process(code):
    return subprocess.Popen([sys.executable, "-c", code])


@pytest.fixture
def cold(monkeypatch, tmp_path):
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(warming.os, "cpu_count", lambda: 2)


def test_only_rungs_that_learn_their_noise_wait(monkeypatch, cold):
    other = process("import time; time.sleep(600)")
    monkeypatch.setattr(warming, "_start", lambda: other)
    with warming.warm_aside(["imm", "sage-husa"]) as aside:
        assert not aside.busy("imm") and aside.busy("sage-husa") and aside.busy("agent")
        other.kill()  # as one that ran out of memory
        aside.wait()
        assert not aside.busy("sage-husa")


def test_the_second_process_ends_with_the_command(monkeypatch, cold):
    other = process("import time; time.sleep(600)")
    monkeypatch.setattr(warming, "_start", lambda: other)
    with pytest.raises(KeyboardInterrupt), warming.warm_aside(["agent"]):
        raise KeyboardInterrupt
    assert other.poll() is not None


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_no_second_process_where_it_would_not_help(monkeypatch, cold, tmp_path):
    started = []
    monkeypatch.setattr(warming, "_start", lambda: started.append(1))
    with warming.warm_aside(["imm", "kf-cv"]):
        assert not started  # nobody learns
    with warming.warm_aside(["imm", "vb-noise"]) as aside:
        assert started == [1]
        aside.wait()  # there is none: no wait
    monkeypatch.setattr(warming.os, "cpu_count", lambda: 1)
    with warming.warm_aside(["vb-noise"]):
        assert started == [1]  # a single core
    monkeypatch.setattr(warming.os, "cpu_count", lambda: 2)
    (tmp_path / "estimators").mkdir()
    (tmp_path / "estimators" / "adaptive_cycle.advance-263.py311.nbi").touch()
    with warming.warm_aside(["vb-noise"]):
        assert started == [1]  # compiled before


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_what_is_compiled_is_named():
    @numba.njit
    def somebody(x):
        return x + 1

    names = []
    with name_what_compiles(names.append):
        somebody(1)
        assert "somebody" in names
        count = len(names)
        somebody(2)
        assert len(names) == count  # compiled: nothing to name
    somebody(1.0)
    assert len(names) == count  # outside
