"""Episodes to watch: `jink play`, `jink check`, films, and the example that records one."""

import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled

import jink.envs
from jink.envs.manoeuvring_target import ManoeuvringTargetTask
from jink.estimators.agent.policy_file import find_policy, save_policy
from jink.training.cli import main
from jink.training.play import PlayRequest, make_environment, play
from jink.training.players import make_player, player_names, scales_of
from jink.training.recording import best_suffix, record

pygame = pytest.importorskip("pygame", reason="needs pip install 'jink[render]'")
gymnasium.register_envs(jink.envs)
ROOT = Path(__file__).resolve().parent.parent
TARGET = "jink/ManoeuvringTarget-v0"


@pytest.fixture(autouse=True)
def no_display(monkeypatch, tmp_path):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.chdir(tmp_path)


def frames(count):
    for number in range(count):
        frame = np.full((64, 96, 3), 255, dtype=np.uint8)
        frame[:, : 10 * (number + 1)] = (0, 114, 178)
        yield frame


def test_a_gif_holds_every_frame(tmp_path):
    image = pytest.importorskip("PIL.Image")
    assert record(tmp_path / "a.gif", frames(5), fps=10.0) == 5
    with image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == 5
        assert film.info["duration"] == 100
        for number, wanted in enumerate(frames(5)):
            film.seek(number)
            np.testing.assert_allclose(np.asarray(film.convert("RGB"), int), wanted.astype(int), atol=4)


def test_a_film_holds_every_frame(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    assert record(tmp_path / "a.mp4", frames(5), fps=10.0) == 5
    film = ffmpeg.read_frames(str(tmp_path / "a.mp4"))
    assert next(film)["size"] == (96, 64)
    shown = [np.frombuffer(frame, np.uint8).reshape(64, 96, 3) for frame in film]
    assert len(shown) == 5 + 15  # the last one stays for one and a half seconds
    for frame, wanted in zip(shown, frames(5), strict=False):
        # Lossy, with half the resolution in colour: far from the edge, and roughly.
        np.testing.assert_allclose(frame[:, ::95].astype(int), wanted[:, ::95].astype(int), atol=12)


def test_a_picture_is_the_last_frame(tmp_path):
    import matplotlib.pyplot as plt

    assert record(tmp_path / "a.png", frames(3), fps=1.0) == 3
    np.testing.assert_array_equal(np.round(255 * plt.imread(tmp_path / "a.png")[..., :3]), list(frames(3))[-1])


@pytest.mark.parametrize("name", ["a.gif", "a.mp4", "a.png"])
def test_an_interrupted_recording_leaves_nothing(tmp_path, name):
    pytest.importorskip("imageio_ffmpeg")
    (tmp_path / name).write_text("older")

    def broken():
        yield from frames(3)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record(tmp_path / name, broken(), fps=10.0)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "older"


def test_what_cannot_be_recorded(tmp_path, monkeypatch):
    with pytest.raises(ValueError, match=r"must end in \.mp4, \.gif, \.png; got a\.avi"):
        record(tmp_path / "a.avi", frames(1), 1.0)
    with pytest.raises(ValueError, match="at least one; got none"):
        record(tmp_path / "a.gif", frames(0), 1.0)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(DependencyNotInstalled, match=r"pip install 'jink\[render\]'"):
        record(tmp_path / "a.mp4", frames(1), 1.0)
    assert not list(tmp_path.iterdir())


def test_playing_writes_the_episode(tmp_path):
    image = pytest.importorskip("PIL.Image")
    out = tmp_path / "e.gif"
    played = play(PlayRequest(TARGET, scenario="switch-v0", seed=3, steps=6, out=out))
    assert (played.env, played.scenario, played.policy, played.seed) == (TARGET, "switch-v0", "imm", 3)
    assert (played.steps, played.out, played.ending) == (6, out, "stopped")
    assert played.score == pytest.approx(np.nansum(played.picture.score))
    assert len(played.picture.times) == 7
    with image.open(out) as film:
        assert film.n_frames == 7
        assert film.size == (960, 640)


def test_the_same_seed_is_the_same_episode(tmp_path):
    out = tmp_path / "e.png"
    first, again, other = (
        play(PlayRequest("ManoeuvringTarget", policy="random", seed=seed, steps=4, out=out)).picture
        for seed in (5, 5, 6)
    )
    for name in ("truth", "seen", "estimate"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
        assert not np.array_equal(getattr(first, name), getattr(other, name), equal_nan=True)


def test_without_a_display_a_file_with_a_speaking_name_is_written():
    played = play(PlayRequest(TARGET, policy="none", seed=2, steps=2))
    assert str(played.out) == f"{played.scenario}-none-2{best_suffix()}"
    assert played.out.stat().st_size > 1000


def test_with_a_display_a_window_opens(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame.display.quit()
    played = play(PlayRequest(TARGET, seed=2, steps=3))
    assert (played.out, played.steps) == (None, 3)
    assert not list(Path().iterdir())
    assert not pygame.display.get_init()


def test_closing_the_window_ends_the_episode(monkeypatch):
    from jink.envs.rendering import Renderer

    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame.display.quit()
    show, shown = Renderer.show, []

    def close_after_three(self, picture):
        shown.append(len(picture.times))
        if len(shown) == 3:
            pygame.event.post(pygame.event.Event(pygame.QUIT))
        return show(self, picture)

    monkeypatch.setattr(Renderer, "show", close_after_three)
    played = play(PlayRequest(TARGET, seed=2))
    assert shown == [1, 2, 3]
    assert played.steps == 2


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (PlayRequest("CartPole-v1"), "environment must be one of jink/ManoeuvringTarget-v0, "),
        (PlayRequest(TARGET, scenario="swich-v0"), "got 'swich-v0'"),
        (PlayRequest(TARGET, policy="huberr"), "policy must be one of imm, "),
        (PlayRequest(TARGET, seed=-1), "--seed: value must be >= 0; got -1"),
        (PlayRequest(TARGET, steps=0), "--steps: value must be >= 1; got 0"),
        (PlayRequest(TARGET, out=Path("e.jpg")), "--out: file must end in .mp4 or .gif or .png"),
        (PlayRequest(TARGET, out=Path("none/e.png")), "--out: file must lie in an existing folder"),
    ],
)
def test_what_play_refuses(request_, words):
    with pytest.raises(ValueError, match=r"must|known") as refused:
        play(request_)
    assert words in str(refused.value)
    assert not list(Path().iterdir())


def play_through(env, name, seed=4, steps=40):
    """Errors of the estimates a player gives, m."""
    observation, info = env.reset(seed=seed)
    player, errors = make_player(name, env, seed), []
    for _ in range(steps):
        observation, _, terminated, _, info = env.step(player(observation))
        errors.append(info["error"])
        if terminated:
            break
    return np.array(errors)


@pytest.mark.parametrize(
    ("policy", "env", "other"),
    [
        ("continuous", "AdaptiveFactorContinuous-v0", "AdaptiveFactor-v0"),
        ("discrete", "AdaptiveFactor-v0", "AdaptiveFactorContinuous-v0"),
    ],
)
def test_an_agent_plays_its_environment(tmp_path, policy, env, other):
    def total(name):
        return play(PlayRequest(env, policy=name, seed=1, steps=60, out=tmp_path / "last.png")).score

    folder = tmp_path / "mine"
    save_policy(find_policy(policy), folder)
    assert total(policy) == total(str(folder)) > total("random")
    with pytest.raises(ValueError, match=f"environment must be jink/{env} for this agent"):
        play(PlayRequest(other, policy=policy, seed=1, steps=2, out=tmp_path / "last.png"))


def test_players_estimate():
    env = make_environment("ManoeuvringTarget-v0", "switch-v0")
    assert player_names(env)[0] == "imm"
    assert {"kf-cv", "none", "random"} <= set(player_names(env))
    quiet = {name: np.sqrt(np.mean(play_through(env, name) ** 2)) for name in ("none", "imm", "random")}
    sigma = env.unwrapped.rollout.source.sensor.sigma[0]
    assert quiet["none"] == pytest.approx(np.sqrt(2) * sigma, rel=0.3)  # 40 samples: 8 % is one sd
    assert quiet["imm"] < quiet["none"] < quiet["random"]


def test_none_repeats_what_was_measured():
    env = make_environment("ManoeuvringTarget-v0", "switch-irregular-v0")
    observation, _ = env.reset(seed=1)
    player, task = make_player("none", env, 0), env.unwrapped.rollout.task
    for _ in range(30):
        before = observation
        observation, *_ = env.step(player(observation))
        picture = task.picture(0, int(env.unwrapped.rollout.k[0]))
        if np.isfinite(picture.seen[-2]).all():
            np.testing.assert_allclose(picture.estimate[-2], picture.seen[-2], rtol=1e-12)
        elif len(picture.times) > 2:
            np.testing.assert_array_equal(picture.estimate[-2], picture.estimate[-3])
        assert before.shape == observation.shape
    assert np.isnan(picture.seen).any()


def test_scales_are_those_of_the_targets():
    source = make_environment("ManoeuvringTarget-v0", "switch-v0").unwrapped.rollout.source
    scales = scales_of(source)
    assert scales.acceleration == pytest.approx(np.sqrt(source.filter_noise))
    assert 3.0 < scales.speed < 30.0  # the scenario's limits, per axis
    assert 2.0 < scales.sojourn < 10.0  # its dwells are of 2 to 6 s


def choice_environments():
    from jink.envs.registration import ENVIRONMENTS

    return [name for name in ENVIRONMENTS if name != TARGET]


@pytest.mark.parametrize("name", choice_environments())
def test_every_player_of_a_choice_plays(name):
    env = make_environment(name)
    names = player_names(env)
    assert "random" in names
    assert not isinstance(env.unwrapped.rollout.task, ManoeuvringTargetTask)
    for player in names:
        observation, _ = env.reset(seed=1)
        act = make_player(player, env, 1)
        for _ in range(3):
            action = act(observation)
            assert env.action_space.contains(action), player
            observation, *_ = env.step(action)
        picture = env.unwrapped.rollout.task.picture(0, 3)
        if player in picture.choices:
            assert picture.choices.index(player) in picture.choice


@pytest.mark.parametrize("name", [TARGET, *choice_environments()])
def test_record_video_works(tmp_path, name):
    pytest.importorskip("moviepy")
    env = gymnasium.make(name, render_mode="rgb_array")
    env = gymnasium.wrappers.RecordVideo(env, str(tmp_path / "films"), video_length=5, disable_logger=True)
    env.action_space.seed(0)
    env.reset(seed=0)
    for _ in range(6):
        env.step(env.action_space.sample())
    env.close()
    assert [path.suffix for path in (tmp_path / "films").iterdir()] == [".mp4"]


def test_the_command_says_what_happened(capsys, tmp_path):
    assert main(["play", "ManoeuvringTarget-v0", "--seed", "1", "--steps", "3", "--out", str(tmp_path / "e.png")]) == 0
    out = capsys.readouterr().out
    assert f"{TARGET} on switch-v0, policy imm, seed 1: 3 decisions, score -" in out
    assert out.rstrip().endswith("e.png")
    assert main(["play", "NoSuch"]) == 2
    assert "must be one of jink/ManoeuvringTarget-v0" in capsys.readouterr().err


def test_the_command_names_a_missing_extra(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pygame", None)
    assert main(["play", "ManoeuvringTarget-v0", "--steps", "2"]) == 2
    assert "pip install 'jink[render]'" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["play", "check"])
def test_help_has_examples(command, capsys):
    assert main([command, "--help"]) == 0
    assert capsys.readouterr().out.count(f"jink {command} ") > 2


def test_check_passes_ours_and_finds_what_others_lack(capsys):
    assert main(["check", "--env", TARGET, "--steps", "20", "--num-envs", "2"]) == 0
    assert " 0 failed" in capsys.readouterr().out
    # Gymnasium's native CartPole shares one generator: its rows are not those of single environments.
    assert main(["check", "--env", "CartPole-v1", "--steps", "20"]) == 1
    assert "rows" in capsys.readouterr().out
    assert main(["check", "--env", "CartPole-v99"]) == 2
    assert main(["check", "--env", "no_such_module:Env-v0"]) == 2
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 2
    assert all(line.startswith("jink: --env: id must be one that Gymnasium knows") for line in errors)


def test_the_example_records_an_episode(tmp_path):
    pytest.importorskip("PIL")
    script = ROOT / "examples" / "record_an_episode.py"
    done = subprocess.run(
        [sys.executable, str(script), str(tmp_path)], env=dict(os.environ), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"episode{best_suffix()}", "episode.png"]
    assert "120 frames" in done.stdout
