import numpy as np
import pytest
from PIL import Image

from lidarnaut.benchmarks.films import NUM_FRAMES, main, record, save_film
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.rendering import style
from lidarnaut.envs.tasks.explore import Explore


@pytest.mark.parametrize("periods", [10, 47, 48, 49, 500, 5000])
def test_pictures_are_at_equal_intervals(periods):
    class Clock(LidarEnv):
        control_period, time = 0.1, 0.0

        def __init__(self):
            pass

        def render(self):
            return np.full((2, 2, 3), self.time)

    env = Clock()
    frames = record(env)
    for k in range(periods):
        env.time = 0.1 * k
        env.on_period(None)
    gaps = np.diff([frame[0, 0, 0] for frame in frames])
    np.testing.assert_allclose(gaps, gaps[0])
    assert min(periods, NUM_FRAMES // 2) <= len(frames) <= NUM_FRAMES


def test_a_film_of_a_drive_keeps_its_colours(tmp_path):
    env = LidarEnv(Explore, physics="kinematic", slam="truth", start="spawn", render_mode="rgb_array")
    env.reset(seed=0)
    frames = record(env, every=1.0)
    for _ in range(25):
        env.step(np.array([1.0, 0.3], dtype=np.float32))
    env.close()
    assert len(frames) == 3  # at 0.1, 1 and 2 s
    save_film(frames, tmp_path / "film.gif", width=640)
    with Image.open(tmp_path / "film.gif") as gif:
        assert (gif.size, gif.n_frames) == ((640, 360), 3)
        gif.seek(2)
        last = np.asarray(gif.convert("RGB")).astype(int)
    wanted = np.asarray(Image.fromarray(frames[-1]).resize((640, 360), Image.Resampling.LANCZOS)).astype(int)
    assert (np.abs(last - wanted).max(axis=2) > 40).mean() < 0.005
    for colour in (style.PAPER, style.OUTSIDE, style.UNKNOWN, style.FLOOR):
        assert (last == colour).all(axis=2).sum() > 1000


def test_one_environment_is_filmed_as_asked_for(tmp_path):
    film, picture = tmp_path / "film.webp", tmp_path / "picture.png"
    main("Explore-v0", film, "nearest", every=2.0, arguments="{world: pimouse_arena}", picture=picture)
    with Image.open(film) as frames, Image.open(picture) as hero:
        assert (frames.format, frames.size[0], hero.size[0] > 720) == ("WEBP", 960, True)
