import numpy as np
from PIL import Image

from benchmarks.pictures import Film, save_gif
from envs.core import LidarEnv
from envs.rendering import style
from envs.tasks.explore import Explore


def test_a_film_of_a_drive_keeps_its_colours(tmp_path):
    env = LidarEnv(Explore, physics="kinematic", slam="truth", start="spawn", render_mode="rgb_array")
    _, info = env.reset(seed=0)
    film = Film(env, every=1.0)
    film.shoot(info)
    for _ in range(25):
        info = env.step(np.array([1.0, 0.3], dtype=np.float32))[4]
        film.shoot(info)
    film.finish()
    env.close()
    assert len(film.frames) == 4  # at 0, 1, 2 s and the end

    save_gif(film.frames, tmp_path / "film.gif", width=640)
    with Image.open(tmp_path / "film.gif") as gif:
        assert gif.size == (640, 360)
        assert gif.n_frames == 4
        pictures = []
        for index in range(4):
            gif.seek(index)
            pictures.append(np.asarray(gif.convert("RGB")).astype(int))
    assert (pictures[0] != pictures[2]).any()
    wanted = np.asarray(Image.fromarray(film.frames[-1]).resize((640, 360), Image.Resampling.LANCZOS)).astype(int)
    assert (np.abs(pictures[-1] - wanted).max(axis=2) > 40).mean() < 0.005
    for colour in (style.PAPER, style.OUTSIDE, style.UNKNOWN, style.FLOOR):
        assert (pictures[-1] == colour).all(axis=2).sum() > 1000
