"""Experiment of Nguyen et al. (2021): drives, measures, tables and figures."""

import math
from collections import Counter

import numpy as np
import pytest

from lidarnaut.benchmarks.drives import ekf as experiment
from lidarnaut.benchmarks.drives.ekf import (
    FAULTS,
    FILTERS,
    PAPER,
    FaultyChannel,
    RouteDrive,
    measure,
    nees_bounds,
    run_drive,
)
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.localization.ekf import Ekf, Measurement
from lidarnaut.envs.localization.fusion import FUSIONS, start_covariance

STEPS = 60


@pytest.fixture(scope="module")
def drive():
    return run_drive("kinematic", 0, {**FILTERS, **FAULTS}, max_steps=STEPS)


def make_drive(errors, covariance):
    truth = np.tile([1.0, 2.0, math.pi - 0.001], (len(errors), 1))
    covariances = np.tile(covariance, (len(errors), 1, 1))
    time, estimated = np.arange(len(errors), dtype=float), {"full": truth + errors}
    return RouteDrive("kinematic", 0, "completed", 0, time, truth, estimated, {"full": covariances}, {})


def test_a_drive_holds_every_fusion_at_every_step_and_is_repeatable(drive):
    assert drive.end_reason == "max_steps"
    assert drive.time == pytest.approx(np.arange(1, STEPS + 1) / 17)
    assert set(drive.estimated) == set(drive.covariance) == {*FUSIONS, *FAULTS}
    for fusion in FUSIONS:
        assert drive.estimated[fusion].shape == drive.truth.shape == (STEPS, 3)
        assert drive.covariance[fusion].shape == (STEPS, 3, 3)
        assert np.abs(drive.error(fusion)).max() < 100.0
    assert drive.truth[-1, 0] > 1.0
    assert drive.verdicts["encoder"] == {"accepted": STEPS}
    # Fusions differ: wheels alone do not use the compass, and the localizer is not filtered.
    errors = [drive.error(fusion) for fusion in FUSIONS]
    assert all((one != other).any() for k, one in enumerate(errors) for other in errors[:k])
    again = run_drive("kinematic", 0, max_steps=20)
    for fusion in FUSIONS:
        np.testing.assert_array_equal(again.estimated[fusion], drive.estimated[fusion][:20])


def test_measures_are_equations_11_and_12():
    errors = np.array([[0.03, 0.0, 0.01], [0.0, -0.04, 0.0], [0.0, 0.0, -0.02], [0.0, 0.0, 0.0]])
    drives = [make_drive(factor * errors, np.eye(3)) for factor in (1.0, 1.0, 2.0)]
    measures = measure(drives, "full")
    assert measures["heading_rmse_deg"] == pytest.approx(math.degrees(math.sqrt(0.0005 / 4)))
    assert measures["max_heading_deg"] == pytest.approx(math.degrees(0.02))
    for key, value in {"position_rmse_mm": 25.0, "max_x_mm": 30.0, "max_y_mm": 40.0}.items():
        assert (measures[key], measures[f"{key}_worst"]) == pytest.approx((value, 2 * value))


def test_nees_tells_honest_from_overconfident():
    covariance = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 0.5]]) * 1e-4
    errors = np.random.default_rng(0).multivariate_normal(np.zeros(3), covariance, (20, 400))
    for scale, nees, within in ((1.0, 3.0, 0.95), (0.5, 6.0, 0.01)):
        found = measure([make_drive(error, scale * covariance) for error in errors], "full")
        assert found["nees"] == pytest.approx(nees, rel=0.05)
        assert found["nees_within"] == pytest.approx(within, abs=0.04)
    assert nees_bounds(20) == pytest.approx((2.024, 4.165), abs=1e-3)


def test_the_stages_measure_and_draw_and_the_start_of_the_full_fusion_beats_the_paper(drive, monkeypatch, tmp_path):
    monkeypatch.setattr(experiment, "run_drive", lambda *_: drive)
    rows = experiment.compare_fusions(seeds=2, jobs=1, physics=("kinematic",), images=tmp_path)
    assert [row["fusion"] for row in rows] == [*experiment.LABELS.values(), "the paper"]
    counts = {"completed": 0, "collisions": 0}
    assert rows[3] == {"fusion": "full fusion", "physics": "kinematic"} | measure([drive, drive], "full") | counts
    assert all(rows[3][key] < value for key, value in PAPER.items())
    for name in ("position", "heading", "errors"):
        assert (tmp_path / f"ekf_{name}.png").stat().st_size > 10_000
    none, *others = experiment.compare_faults(seeds=1)
    assert (none["fault"], none["accepted"], none["gated"]) == ("none", 1.0, 0.0)
    assert none["position_max_mm"] < 20.0
    assert [row["fault"] for row in others] == list(FAULTS)[1:]


def test_faults_reach_the_filter_as_they_are_called():
    num_steps, verdicts = 17 * 20, {}
    encoder, pose = np.diag([0.02, 0.02]) ** 2, np.diag([0.02, 0.02, 0.01]) ** 2
    for name, fault in FAULTS.items():
        started, errors = Ekf(), []
        started.reset(Pose2D(0.0, 0.0, 0.0), start_covariance())
        channel = FaultyChannel(started, fault, np.random.default_rng(0))
        for k in range(num_steps):
            # At rest from 30 s on, because the time of silence is included.
            time = 30.0 + (k + 1) / 17
            measurements = [Measurement(time, kind, np.zeros(2), encoder) for kind in ("encoder", "compass")]
            if k % 5 == 0:
                measurements.append(Measurement(time, "map", np.zeros(3), pose))
            errors.append(channel.deliver(time, measurements).pose)
        assert np.abs(errors).max() < 0.3, name
        verdicts[name] = channel.ekf.counts
    assert verdicts["none"]["encoder"] == Counter(accepted=num_steps)
    assert verdicts["no map"]["map"] == {}
    assert 15 < verdicts["one in ten 3 s late"]["compass"]["too_old"] < 55
    assert 5 < verdicts["one in twenty wrong by metres"]["encoder"]["gated"] < 35
    assert 140 < verdicts["half of all missing"]["encoder"]["accepted"] < 200
    assert verdicts["all silent for 5 s"]["encoder"]["accepted"] == num_steps - 84
    late = verdicts["each up to 0.8 s late, out of order"]["encoder"]
    assert late["accepted"] > num_steps - 20
    assert "too_old" not in late
