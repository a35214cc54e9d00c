import numpy as np

from lidarnaut.envs.player.recording import CANDIDATE_COLUMNS, FREE, OCCUPIED, Recording


def synthetic(
    duration, size=(12.0, 8.0), num_candidates=5, explorer="made_up", flicker=20, seed=0, is_bare=False, has_trees=False
):
    """Return an episode in a hall of `size` [m] with a map that grows by columns; one sample per 0.5 s.

    `flicker` cells in the last three metres change with every sample, and every fourth second is a decision for the
    last candidate, which has the highest score; the third one has none.
    `has_trees`: with two random trees, a found point and two goals; one tree vanishes after 40 s.
    `is_bare`: with a person and another robot, without map, candidates, plan and pose error.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, duration + 0.25, 0.5)
    n, (width, height), resolution = len(time), size, 0.05
    columns, rows = round(width / resolution), round(height / resolution)
    share = time / duration
    x, y = 1.0 + (width - 2.0) * share, height / 2 + 0.3 * height * np.sin(0.1 * time)
    true_poses = np.column_stack([x, y, 0.5 * np.cos(0.1 * time)])
    truth = np.full((rows, columns), FREE, dtype=np.uint8)
    truth[[0, -1]] = truth[:, [0, -1]] = OCCUPIED
    index = np.arange(rows * columns).reshape(rows, columns)
    cells, changes = [], []
    known, before = 0, np.empty(0, dtype=np.int64)
    for now in np.rint((0.15 + 0.85 * share) * columns).astype(int):
        near = rng.integers(max(1, known - 60), max(2, known - 1), size=flicker)
        taken = np.unique(rng.integers(1, rows - 1, size=flicker) * columns + near) if known else before
        flipped = np.setxor1d(taken, before)  # to occupied; those of the last sample go back to free
        cells.append(np.concatenate([flipped, index[:, known:now].ravel()]))
        changes.append(np.concatenate([np.full(len(flipped), FREE ^ OCCUPIED), truth[:, known:now].ravel()]))
        order = np.argsort(cells[-1])
        cells[-1], changes[-1] = cells[-1][order], changes[-1][order]
        known, before = now, taken
    decisions = np.arange(0.0, duration, 4.0)
    candidates = rng.uniform(0.5, 7.0, (len(decisions) * num_candidates, len(CANDIDATE_COLUMNS)))
    candidates[:, 4] = 0.0
    scores = candidates[:, 5].reshape(len(decisions), num_candidates)
    scores[:, 2:3], scores[:, -1:] = np.nan, 8.0
    noise = rng.normal(0.0, 0.02, (n, 2))
    angles = np.linspace(-np.pi, np.pi, 90, endpoint=False)
    about = {}
    if is_bare:
        noise, about = 0.0 * noise, {"bodies": ["blind", "robot"]}
        cells, changes = [np.empty(0, dtype=int)] * n, [np.empty(0, dtype=int)] * n
        decisions, candidates = decisions[:0], candidates[:0]
    num_bodies = len(about.get("bodies", [""]))
    about |= {"explorer": explorer, "world": "hall", "robot": "burger", "radius": 0.15, "start": [0.0, 0.0, 0.0]}
    about |= {"seed": seed, "end_reason": "time_limit", "progress": "explored", "figures": {"explored [%]": "100.0"}}
    about["lidar"] = {"range_max": 3.5, "mount": [0.0, 0.0, 0.0], "angles": angles.tolist(), "is_full_turn": True}
    about["map"] = {"shape": [rows, columns], "resolution": resolution, "origin": [0.0, 0.0]}
    about["floor"] = {"resolution": resolution, "origin": [0.0, 0.0]}
    return Recording.of(
        about=about,
        time=time,
        true_poses=true_poses,
        poses=np.column_stack([true_poses[:, :2] + noise, true_poses[:, 2]]),
        goals=np.full((n, 2), np.nan),
        progress=(0.15 + 0.85 * share),
        path_length=(0.2 * time),
        contacts=(time // 50),
        scans=rng.normal(180.0, 8.0, (n, 90)).clip(1, 255),
        map_cells=np.concatenate(cells),
        map_changes=np.concatenate(changes),
        map_ends=np.cumsum([len(one) for one in cells]),
        plans=rng.uniform(0.0, 5.0, (0 if is_bare else 6 * n, 2)),
        plan_ends=(0 if is_bare else 6) * np.arange(1, n + 1),
        decision_times=decisions,
        decision_chosen=np.full(len(decisions), num_candidates - 1, dtype=np.int32),
        candidates=candidates,
        candidate_ends=(num_candidates * np.arange(1, len(decisions) + 1)),
        markers=[
            (0, 0, 1.5, 5.0, 1.5, 5.0),
            (0, 1, 2.5, 2.0, 2.5, 2.0),
            (0, 2, 2.0, 6.0, 2.0, 6.0),
            (0, 3, 1.0, 1.0, 4.0, 6.5),
            (0, 4, 1.0, 1.0, 1.0, 7.0),
            (80, 4, 1.0, 1.0, 1.0, 7.0),
        ][: 6 * has_trees],
        segments=[(0, 0, width, 0), (width, 0, width, height), (width, height, 0, height), (0, height, 0, 0)],
        circles=[(width / 2, 1.0, 0.3)],
        route=[],
        people_radii=[0.2] * num_bodies,
        people=np.hstack([np.column_stack([x, y + 1.0 + k, 0.0 * x, 0.0 * x + 0.5]) for k in range(num_bodies)]),
        tracks=np.column_stack([x, y, 0.0 * x, 0.0 * x + 0.5, 0.0 * x + 0.2])[: 0 if is_bare else n],
        track_ends=np.arange(1, n + 1) * (not is_bare),
        floor=truth == FREE,
    )
