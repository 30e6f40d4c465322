"""Record an episode: an IMM tracks a drone that changes its mind while the noise surges.

python examples/record_an_episode.py [FOLDER]

writes episode.png, the last frame, and episode.mp4 (episode.gif without an encoder for films).
"""

import sys
from pathlib import Path

import gymnasium
import matplotlib.image

from jink.envs.policies import EstimatorPolicy
from jink.estimators.recipes import make_estimator
from jink.training.recording import best_suffix, record


def play(env, policy, seed):
    """Frames of one episode, as they happen."""
    observation, _ = env.reset(seed=seed)
    yield env.render()
    over = False
    while not over:
        observation, _, terminated, truncated, _ = env.step(policy(observation))
        over = terminated or truncated
        yield env.render()


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    env = gymnasium.make("jink.envs:jink/ManoeuvringTarget-v0", scenario="joint-v0", steps=120, render_mode="rgb_array")
    sensor = env.unwrapped.rollout.source.sensor
    policy = EstimatorPolicy(make_estimator("imm", sensor, acceleration=4.5, speed=12.0, sojourn=4.0), env)

    film = folder / f"episode{best_suffix()}"
    count = record(film, play(env, policy, seed=3), fps=15)
    matplotlib.image.imsave(folder / "episode.png", env.render())
    env.close()
    print(f"wrote {folder / 'episode.png'} and {film}, {count} frames")
