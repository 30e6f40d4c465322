"""A learner without learning: what `jink train intents` asks of one, with checkpoints and a kill where wanted."""

import json
import os
import signal

import numpy as np

from jink.intent.laws import Birth, Law, Phase
from jink.intent.model import Intent, IntentModel
from jink.intent.progress import Progress

STEPS = 8


class StandInLearner:
    """Sums the data in eight steps, a checkpoint after each; ``kill_at`` stops the process before that step."""

    def __init__(self, axes=2, progress=None, checkpoint=None, seed=0, kill_at=None, **options):
        self.axes, self.progress, self.checkpoint, self.seed = axes, progress, checkpoint, seed
        self.kill_at, self.options = kill_at, options

    def fit(self, tracks):
        self.checkpoint.mkdir(parents=True, exist_ok=True)
        file = self.checkpoint / "state.json"
        state = json.loads(file.read_text()) if file.exists() else {"step": 0, "sum": 0.0}
        rng = np.random.default_rng(self.seed)
        draws = rng.normal(size=STEPS)
        for step in range(state["step"], STEPS):
            if step == self.kill_at:
                os.kill(os.getpid(), signal.SIGKILL)
            more = float(np.nanmean(tracks.measurements[:, step])) + draws[step]
            state = {"step": step + 1, "sum": state["sum"] + more}
            part = file.with_suffix(".part")
            part.write_text(json.dumps(state))
            part.replace(file)
            stage = "fit" if step < 6 else "eliminate"
            self.progress(Progress(stage, step + 1, STEPS, 3 if step < 6 else 2, -8.0 + 0.1 * step))
        self.model_ = stand_in_model(self.axes, state["sum"])
        self.curve_ = [(1, -7.5, -7.6, -7.4), (2, -7.3, -7.4, -7.2), (3, -7.3, -7.41, -7.19)]
        self.resolvable_ = True
        return self


def stand_in_model(axes=2, number=0.0):
    turn_mean, mirrored = (0.1, True) if axes == 2 else (0.0, False)
    straight = Phase(Law(axes, wobble=0.1), (Birth(1.0, 0.0, 0.002, 0.0, 0.002),))
    turn = Phase(
        Law(axes, turn_rate=0.05, turn_noise=1e-5, wobble=0.1), (Birth(1.0, 0, 0.01, turn_mean, 0.05),), mirrored
    )
    return IntentModel(
        axes,
        (Intent("straight", (straight,)), Intent("turn", (turn,), renewal=0.02)),
        ((-0.1, 0.1), (0.2, -0.2)),
        (0.5, 0.5),
        None,
        10.0 + abs(number),
        {"held_out": -7.3},
    )
