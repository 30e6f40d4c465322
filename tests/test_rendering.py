"""Frames: what they hold and where, that they depend on the picture alone, windows, missing pygame."""

import sys
from itertools import combinations, pairwise

import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled

from jink.envs.drawing import canvas as drawing
from jink.envs.drawing.canvas import FAINT, INK, PAPER, SURGE, Canvas, fade, intent_colours
from jink.envs.drawing.map_panel import draw_map, grid_step, metres, ring_radius
from jink.envs.drawing.strip_panels import Clock, draw_actions, draw_altitude, draw_intents, draw_noise, last_choice
from jink.envs.drawing.viewing import grow, round_down, span, ticks, view_of, worth_showing
from jink.envs.rendering import Renderer
from jink.envs.task import Picture

pygame = pytest.importorskip("pygame", reason="needs pip install 'jink[render]'")

INTENTS = ("straight", "turn", "weave")
CHOICES = ("none", "Huber", "skip")
WHOLE = (0.0, 0.0, 600.0, 400.0)


def picture(count=60, axes=2, **changed):
    """A target flying east at 20 m/s, measured every second with 5 m, in a surge from sample 30 to 39."""
    rng = np.random.default_rng(3)
    times = np.arange(count, dtype=float)
    truth = np.zeros((count, axes))
    truth[:, 0] = 20.0 * times
    truth[:, 2:] = 500.0 + 2.0 * times[:, None]
    scale = np.where((times >= 30) & (times < 40), 100.0, 1.0)
    seen = truth + 5.0 * np.sqrt(scale)[:, None] * rng.normal(size=truth.shape)
    fields = {
        "title": "straight-v0",
        "times": times,
        "truth": truth,
        "seen": seen,
        "estimate": truth + rng.normal(size=truth.shape),
        "covariance": 9.0 * np.eye(axes),
        "sensor": np.full(axes, -5000.0),
        "intents": INTENTS,
        "intent": (times >= 20).astype(np.int8),
        "scale": scale,
        "choices": CHOICES,
        "choice": np.where(scale > 4, 1, 0),
        "score": np.full(count, 0.5),
    }
    return Picture(**(fields | changed))


def cut(whole, count):
    """The same episode when ``count`` samples of it had happened."""
    rows = ("times", "truth", "seen", "estimate", "intent", "scale", "choice", "score")
    return whole._replace(**{name: getattr(whole, name)[:count] for name in rows})


def image_of(canvas):
    pixels = pygame.surfarray.array3d(canvas.finish()).transpose(1, 0, 2)
    return lambda place: tuple(int(c) for c in pixels[int(place[1]), int(place[0])])  # pixel n spans n to n + 1


def near(colour, wanted, by=12):
    return max(abs(a - b) for a, b in zip(colour, wanted, strict=True)) <= by


@pytest.mark.parametrize("size", [(960, 640), (320, 240), (1300, 500)])
@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("choices", [(), CHOICES])
def test_frames_are_images_of_the_size_asked_for(size, axes, choices):
    frame = Renderer(size).frame(picture(axes=axes, choices=choices))
    assert frame.shape == (size[1], size[0], 3)
    assert frame.dtype == np.uint8
    assert frame.flags.c_contiguous
    assert frame.flags.writeable
    assert len(np.unique(frame[..., 0])) > 100  # something is drawn, and smoothed


def test_a_frame_depends_on_its_picture_alone_and_leaves_it_untouched():
    first, renderer = picture(), Renderer()
    before = first._replace(**{n: v.copy() for n, v in first._asdict().items() if isinstance(v, np.ndarray)})
    frame = renderer.frame(first)
    renderer.frame(picture(axes=3))
    again = renderer.frame(first)
    np.testing.assert_array_equal(frame, again)
    np.testing.assert_array_equal(frame, Renderer().frame(first))
    assert not np.shares_memory(frame, again)
    for name, value in before._asdict().items():
        np.testing.assert_array_equal(value, getattr(first, name), err_msg=name)


def test_arrays_need_no_display(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "no-such-driver")
    pygame.display.quit()
    Renderer().frame(picture())
    assert not pygame.display.get_init()


def drawn_map(shown, box=WHOLE):
    canvas = Canvas((600, 400))
    view = draw_map(canvas, shown, box, intent_colours(shown.intents), 1.0)
    return view, image_of(canvas)


def test_the_map_shows_things_where_they_are():
    far = np.full((60, 2), np.nan)
    shown = picture(seen=far, estimate=far, covariance=np.full((2, 2), np.nan))
    view, pixel = drawn_map(shown)
    colours = intent_colours(INTENTS)
    assert near(pixel(view.project(shown.truth[-1])), colours[1])
    # The latest samples at nearly full strength, old ones paler but of their own intent's hue.
    assert near(pixel(view.project(shown.truth[-4])), colours[1], by=40)
    assert near(pixel(view.project(shown.truth[5])), fade(colours[0], 0.45, FAINT))
    assert pixel(view.project(shown.truth[5] + [0.0, 60.0])) == FAINT


def test_the_estimate_and_its_ellipse_are_where_they_are():
    shown = picture(seen=np.full((60, 2), np.nan), covariance=np.diag([3600.0, 100.0]))
    shown.estimate[-1] = shown.truth[-1] + [-200.0, 90.0]
    view, pixel = drawn_map(shown)
    assert near(pixel(view.project(shown.estimate[-1])), INK, by=30)
    for away, inside in (([110.0, 0.0], True), ([130.0, 0.0], False), ([0.0, 17.0], True), ([0.0, 24.0], False)):
        colour = pixel(view.project(shown.estimate[-1] + away))
        assert near(colour, fade(INK, 0.12), by=3) == inside, away


def test_the_last_estimate_there_is_is_marked():
    """A task that takes estimates as actions has none for the sample just shown."""
    shown = picture(seen=np.full((60, 2), np.nan), covariance=np.full((2, 2), np.nan))
    shown.estimate[-1], shown.estimate[-2] = np.nan, shown.truth[-2] + [-100.0, 80.0]
    view, pixel = drawn_map(shown)
    middle = view.project(shown.estimate[-2])
    assert near(pixel(middle + np.array([4.0, 0.0])), INK, by=40)
    assert near(pixel(middle + np.array([0.0, 4.0])), INK, by=40)


def test_surges_make_rings_and_calm_makes_discs():
    shown = picture(seen=np.full((60, 2), np.nan), estimate=np.full((60, 2), np.nan))
    shown.seen[[25, 35]] = shown.truth[[25, 35]] + [0.0, 120.0]
    view, pixel = drawn_map(shown)
    assert not near(pixel(view.project(shown.seen[25])), FAINT, by=60)
    middle = view.project(shown.seen[35])
    assert near(pixel(middle), FAINT, by=3)
    assert not near(pixel(middle + np.array([ring_radius(100.0) - 0.5, 0.0])), FAINT, by=20)
    assert ring_radius(1.0) == ring_radius(0.0) < ring_radius(10.0) < ring_radius(1e4) < 12.0


def test_a_sensor_off_the_map_is_pointed_at():
    shown = picture(seen=np.full((60, 2), np.nan))
    renderer = Renderer()
    without = renderer.frame(shown._replace(sensor=np.full(2, np.nan)))
    marked = (renderer.frame(shown) != without).any(axis=2)[:, :700]  # left of the key, which names it too
    down, across = np.nonzero(marked)
    assert marked.any()
    assert across.max() < 250  # it lies far to the lower left
    assert down.min() > 300


def strip(draw, shown, *more):
    canvas, box = Canvas((600, 100)), (100.0, 0.0, 500.0, 80.0)
    clock = Clock(shown, box[0], box[2])
    draw(canvas, shown, box, clock, *more)
    return clock, image_of(canvas)


def test_the_intent_strip_changes_colour_when_the_intent_does():
    shown, colours = picture(), intent_colours(INTENTS)
    clock, pixel = strip(draw_intents, shown, colours, 1.0)
    for moment, intent in ((1.0, 0), (19.4, 0), (20.6, 1), (59.0, 1)):
        assert pixel((clock.at(moment), 4)) == colours[intent], moment
    assert pixel((clock.at(61.5), 4)) == PAPER


@pytest.mark.parametrize("step", [0.2, 1.0, 60.0])
def test_the_first_frame_shows_no_intent_beyond_the_present(step):
    whole, colours = picture(), intent_colours(INTENTS)
    shown = cut(whole._replace(times=step * whole.times), 1)
    clock, pixel = strip(draw_intents, shown, colours, 1.0)
    assert clock.edges.tolist() == [100.0, 100.0]
    assert pixel((102.0, 40)) == PAPER
    clock, _ = strip(draw_intents, cut(whole._replace(times=step * whole.times), 2), colours, 1.0)
    assert clock.hold == step


def test_the_noise_strip_is_logarithmic():
    clock, pixel = strip(draw_noise, picture(), 1.0)
    # 100 is two of the four decades: half of the 80 pixels.
    assert pixel((clock.at(35.5), 45)) == SURGE
    assert pixel((clock.at(35.5), 35)) == PAPER
    assert pixel((clock.at(29.5), 70)) == PAPER
    shown = picture(scale=np.full(60, 1e8))  # the axis makes room
    clock, pixel = strip(draw_noise, shown, 1.0)
    assert pixel((clock.at(35.5), 5)) == SURGE


def test_missing_measurements_are_ticks_above_the_noise():
    shown = picture()
    shown.seen[12] = np.nan
    clock, pixel = strip(draw_noise, shown, 1.0)
    assert near(pixel((clock.at(12.5), 3)), INK, by=60)
    assert pixel((clock.at(13.5), 3)) == PAPER


def test_the_action_strip_marks_the_row_of_the_choice():
    shown = picture()
    clock, pixel = strip(draw_actions, shown, 60.0, 1.0)
    rows = [80 * (n + 0.5) / 3 for n in range(3)]
    for moment, choice in ((10.5, 0), (35.5, 1), (45.5, 0)):
        assert [near(pixel((clock.at(moment), y)), fade(INK, 0.75)) for y in rows] == [n == choice for n in range(3)]


def test_the_last_choice_is_that_of_the_last_decision():
    shown = picture(choice=np.full(60, 2))
    shown.choice[-1] = 0
    assert last_choice(shown) == 0
    shown.choice[-1] = -1  # an observation: its decision is still to come
    assert last_choice(shown) == 2
    assert last_choice(cut(picture(choice=np.full(60, -1)), 1)) == -1


def test_altitude_is_drawn_for_three_axes():
    shown = picture(axes=3, seen=np.full((60, 3), np.nan), estimate=np.full((60, 3), np.nan))
    colours = intent_colours(INTENTS)
    clock, pixel = strip(draw_altitude, shown, colours, 1.0)

    def height(moment):
        column = [y for y in range(80) if near(pixel((clock.at(moment), y)), fade(colours[moment >= 20], 0.8), by=30)]
        assert column, moment
        return np.mean(column)

    places = [height(moment) for moment in (5.0, 30.0, 55.0)]
    assert places[0] > places[1] > places[2]  # it climbs
    assert places[0] - places[1] == pytest.approx(places[1] - places[2], abs=1.5)  # steadily; pixels are whole


def test_the_view_only_grows_and_holds_the_truth():
    shown = picture(count=200)
    shown.truth[:, 1] = 300.0 * np.sin(0.1 * shown.times)
    boxes = []
    for count in range(1, 201, 7):
        part = cut(shown, count)
        view = view_of(part, 600.0, 400.0, (300.0, 200.0))
        pixels = view.project(part.truth)
        assert ((pixels >= 0) & (pixels <= [600, 400])).all()
        half = np.array([300.0, 200.0]) / view.scale
        boxes.append((view.centre - half, view.centre + half))
    slack = 1e-9 * 4000.0  # rounding of places of some 4000 m
    for (low, high), (lower, higher) in pairwise(boxes[1:]):
        assert (lower <= low + slack).all()
        assert (higher >= high - slack).all()
    assert len({float(low[0]) for low, _ in boxes}) < len(boxes) / 2  # by steps, not with every sample


def test_surges_and_wild_estimates_do_not_move_the_view():
    calm = picture(scale=np.ones(60))
    loud = calm._replace(scale=calm.scale.copy(), seen=calm.seen.copy(), estimate=calm.estimate.copy())
    loud.seen[33], loud.scale[33] = loud.truth[33] + [0.0, 400.0], 1e4
    loud.estimate[40] = [-1e9, 0.0]
    calm.seen[33] = calm.estimate[40] = np.nan
    assert view_of(loud, 600.0, 400.0, (0.0, 0.0)).scale == view_of(calm, 600.0, 400.0, (0.0, 0.0)).scale
    assert 50.0 < grow(np.array([[0.0, 0.0], [50.0, 0.0]]), np.array([True, True]), 1.0, 1.0)[1][0] < 100.0


def test_only_what_is_known_is_shown():
    places, must = worth_showing(picture(count=2, truth=np.full((2, 2), np.nan)))
    assert len(places) == 4
    assert not must.any()


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e9])
def test_any_size_of_scene_fills_the_map(size):
    shown = picture()
    scaled = shown._replace(
        truth=size * shown.truth,
        seen=size * shown.seen,
        estimate=size * shown.estimate,
        covariance=size**2 * shown.covariance,
        sensor=size * shown.sensor,
    )
    path = view_of(scaled, 600.0, 400.0, (300.0, 200.0)).project(scaled.truth)
    assert np.ptp(path[:, 0]) > 250
    assert Renderer().frame(scaled).std() > 5


NAN2 = np.full((60, 2), np.nan)


@pytest.mark.parametrize(
    "changed",
    [
        {"truth": NAN2, "estimate": NAN2, "covariance": np.full((2, 2), np.nan), "sensor": np.full(2, np.nan)},
        {"truth": NAN2, "estimate": NAN2, "seen": NAN2},
        {"scale": np.full(60, np.nan)},
        {"scale": np.full(60, np.inf)},
        {"scale": np.zeros(60)},
        {"score": np.full(60, np.nan)},
        {"covariance": np.diag([1e30, 0.0])},
        {"covariance": np.diag([-1.0, -1.0])},
        {"estimate": np.full((60, 2), 1e300)},
        {"seen": np.full((60, 2), -1e300)},
        {"truth": np.zeros((60, 2)), "seen": np.zeros((60, 2)), "estimate": np.zeros((60, 2))},
        {"times": np.zeros(60)},
        {"intent": np.full(60, -1, dtype=np.int8), "intents": ()},
        {"choice": np.full(60, -1)},
        {"title": "a scenario with a very long name " * 10, "choices": ("a choice with a very long name " * 5,) * 14},
    ],
)
@pytest.mark.parametrize("count", [1, 2, 60])
def test_nothing_in_a_picture_breaks_a_frame(changed, count):
    with np.errstate(all="raise", under="ignore"):
        frame = Renderer((480, 360)).frame(cut(picture(**changed), count))
    assert frame.shape == (360, 480, 3)


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("count", [1, 7, 60])
@pytest.mark.parametrize("size", [(960, 640), (960, 720), (480, 320)])
def test_no_two_texts_overlap(monkeypatch, axes, count, size):
    kept = []
    finish = Canvas.finish
    monkeypatch.setattr(drawing.Canvas, "finish", lambda self: kept.extend(self._texts) or finish(self))
    long = {"title": "a scenario with a long name " * 9, "choices": ("none", "a choice with a long name " * 3, "skip")}
    Renderer(size).frame(cut(picture(axes=axes, **(long if count == 7 else {})), count))
    assert len(kept) > 10
    # The letters themselves, not the line they stand on.
    boxes = [image.get_bounding_rect().move(round(left), round(top)) for image, (left, top) in kept]
    assert not [pair for pair in combinations(boxes, 2) if pair[0].colliderect(pair[1])]
    assert all(box.left >= 0 and box.right <= size[0] and box.bottom <= size[1] for box in boxes)


def test_round_numbers():
    assert [round_down(value) for value in (1.0, 1.9, 2.0, 4.9, 5.0, 9.9, 0.03, 7e5)] == [
        1.0, 1.0, 2.0, 2.0, 5.0, 5.0, pytest.approx(0.02), 5e5,
    ]  # fmt: skip
    assert [span(value) for value in (0.0, 10.0, 11.0, 16.0, 76.0, 0.2)] == [1.0, 10.0, 15.0, 20.0, 100.0, 0.2]
    assert ticks(0.0, 50.0, 5) == [0.0, 10.0, 20.0, 30.0, 40.0, 50.0]
    assert [metres(value) for value in (0.0, 0.0025, 0.5, 40.0, 12_345.0)] == [
        "0 m",
        "2.5 mm",
        "50 cm",
        "40 m",
        "12.3 km",
    ]
    view = view_of(picture(), 600.0, 400.0, (0.0, 0.0))
    assert f"{grid_step(view, 1.0):e}"[0] in "125"
    assert 50 < grid_step(view, 1.0) * view.scale < 150


def test_intents_keep_their_colours():
    colours = intent_colours([f"intent {n}" for n in range(12)])
    assert len(set(colours.values())) == 13
    shared, more = intent_colours(("turn", "straight")), intent_colours(("orbit", "mine", "straight", "turn"))
    assert (shared[0], shared[1]) == (more[3], more[2])
    assert len(set(more.values())) == 5


@pytest.fixture
def window(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame.display.quit()
    renderer = Renderer((480, 360), "human", fps=1000.0)
    yield renderer
    renderer.close()


def test_a_window_shows_the_frame_until_it_is_closed(window):
    shown = picture()
    assert window.show(shown)
    on_screen = pygame.surfarray.array3d(pygame.display.get_surface()).transpose(1, 0, 2)
    np.testing.assert_array_equal(on_screen, window.frame(shown))
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    assert not window.show(shown)
    assert window.closed
    assert not pygame.display.get_init()
    assert not window.show(shown)  # and stays closed
    assert not pygame.display.get_init()


def test_escape_closes_the_window(window):
    assert window.show(picture())
    pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.K_ESCAPE))
    assert not window.show(picture())


def test_closing_twice_is_closing_once(window):
    window.close()
    window.show(picture())
    window.close()
    window.close()
    assert not pygame.display.get_init()
    assert window.show(picture())  # closed by the program, not by the user: it opens again


def test_the_window_keeps_its_pace(window):
    paces = []
    window.show(picture())
    window._clock = type("Clock", (), {"tick": lambda self, fps: paces.append(fps)})()
    window.show(picture())
    assert paces == [1000.0]


def test_without_a_display_a_window_is_refused_in_one_sentence(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "no-such-driver")
    pygame.display.quit()
    with pytest.raises(OSError, match=r"^Renderer: a display must be there .* Use mode rgb_array\.$"):
        Renderer(mode="human").show(picture())


def test_without_pygame_the_install_command_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(DependencyNotInstalled, match=r"^Renderer: pygame must .* pip install 'jink\[render\]'\.$"):
        Renderer()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"mode": "ansi"}, "mode must be one of rgb_array, human; got 'ansi'"),
        ({"size": (100, 100)}, "size must be whole pixels, at least 320 x 240"),
        ({"size": (960.5, 640)}, "size must be whole pixels"),
        ({"size": (960,)}, "size must be whole pixels"),
        ({"fps": 0.0}, "fps must be > 0"),
        ({"fps": float("nan")}, "fps must be > 0"),
    ],
)
def test_what_a_renderer_refuses(arguments, words):
    with pytest.raises(ValueError, match=r"^Renderer: ") as refused:
        Renderer(**arguments)
    assert words in str(refused.value)


def test_an_empty_picture_is_refused():
    with pytest.raises(ValueError, match=r"^Renderer: picture must hold samples"):
        Renderer().frame(cut(picture(), 0))
