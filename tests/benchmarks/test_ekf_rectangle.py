"""The experiment of Nguyen et al. (2021): its drives, its measures, and what it prints, writes and draws."""

import json
import math

import numpy as np
import pytest

from benchmarks.ekf_rectangle import __main__ as experiment
from benchmarks.ekf_rectangle.drive import PAPER, Drive, measure, nees_bounds, run_drive
from benchmarks.ekf_rectangle.faults import FAULTS, FaultyChannel
from envs.geometry import Pose2D
from envs.localization.ekf import Ekf, Measurement
from envs.localization.fusion import FUSIONS, start_covariance

STEPS = 60


@pytest.fixture(scope="module")
def drive():
    return run_drive("kinematic", 0, max_steps=STEPS)


def make_drive(errors, covariance, seed=0):
    """A drive with given errors of one fusion."""
    truth = np.tile([1.0, 2.0, math.pi - 0.001], (len(errors), 1))
    return Drive(
        physics="kinematic",
        seed=seed,
        end_reason="completed",
        collisions=0,
        time=np.arange(len(errors), dtype=float),
        truth=truth,
        deviation=np.zeros(len(errors)),
        estimated={"full": truth + errors},
        covariance={"full": np.tile(covariance, (len(errors), 1, 1))},
        counts={},
    )


def test_a_drive_holds_every_fusion_at_every_step(drive):
    assert drive.end_reason == "max_steps"
    assert drive.time == pytest.approx(np.arange(1, STEPS + 1) / 17)
    assert set(drive.estimated) == set(drive.covariance) == set(FUSIONS)
    for fusion in FUSIONS:
        assert drive.estimated[fusion].shape == drive.truth.shape == (STEPS, 3)
        assert drive.covariance[fusion].shape == (STEPS, 3, 3)
        assert np.abs(drive.error(fusion)).max() < 0.1
    assert drive.truth[-1, 0] > 1.0
    assert drive.counts["encoder"] == drive.counts["compass"] == {"accepted": STEPS}
    # Fusions differ: wheels alone do without the compass, the localizer is not filtered.
    errors = [drive.error(fusion) for fusion in FUSIONS]
    assert all((one != other).any() for k, one in enumerate(errors) for other in errors[:k])


def test_the_same_seed_gives_the_same_drive(drive):
    again = run_drive("kinematic", 0, max_steps=20)
    for fusion in FUSIONS:
        np.testing.assert_array_equal(again.estimated[fusion], drive.estimated[fusion][:20])


def test_measures_are_equations_11_and_12():
    errors = np.array([[0.03, 0.0, 0.01], [0.0, -0.04, 0.0], [0.0, 0.0, -0.02], [0.0, 0.0, 0.0]])
    worse = make_drive(2.0 * errors, np.eye(3))
    measures = measure([make_drive(errors, np.eye(3)), make_drive(errors, np.eye(3)), worse], "full")
    assert measures["position_rmse"] == pytest.approx(0.025)
    assert measures["position_rmse_worst"] == pytest.approx(0.05)
    assert measures["heading_rmse"] == pytest.approx(math.degrees(math.sqrt(0.0005 / 4)))
    assert (measures["max_x"], measures["max_y"]) == pytest.approx((0.03, 0.04))
    assert (measures["max_x_worst"], measures["max_y_worst"]) == pytest.approx((0.06, 0.08))
    assert measures["max_heading"] == pytest.approx(math.degrees(0.02))


def test_nees_tells_honest_from_overconfident():
    covariance = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 0.5]]) * 1e-4
    rng = np.random.default_rng(0)
    errors = [rng.multivariate_normal(np.zeros(3), covariance, 400) for _ in range(20)]
    honest = measure([make_drive(error, covariance) for error in errors], "full")
    assert honest["nees"] == pytest.approx(3.0, abs=0.15)
    assert honest["nees_within"] == pytest.approx(0.95, abs=0.04)
    overconfident = measure([make_drive(error, covariance / 2) for error in errors], "full")
    assert overconfident["nees"] == pytest.approx(6.0, abs=0.3)
    assert overconfident["nees_within"] < 0.05
    low, high = nees_bounds(20)
    assert (low, high) == pytest.approx((2.024, 4.165), abs=1e-3)


def test_the_command_prints_writes_and_draws(drive, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(experiment, "run_drives", lambda physics, seeds, jobs: [drive] * seeds)
    experiment.main(
        seeds=2, jobs=1, physics=("kinematic",), json_path=tmp_path / "out.json", images=tmp_path / "images"
    )
    printed = capsys.readouterr().out
    for words in ("encoder alone", "AMCL alone", "encoder + compass", "full fusion", "paper", "20.3", "0.694", "NEES"):
        assert words in printed
    written = json.loads((tmp_path / "out.json").read_text())
    assert set(written) == set(FUSIONS)
    expected = measure([drive, drive], "full")
    assert written["full"]["kinematic_position_rmse"] == pytest.approx(expected["position_rmse"])
    assert {f"kinematic_{key}" for key in PAPER} < set(written["full"])
    for name in ("position", "heading", "errors"):
        assert (tmp_path / "images" / f"ekf_{name}.png").stat().st_size > 10_000


def test_the_start_of_the_full_fusion_beats_the_paper(drive):
    measures = measure([drive], "full")
    for key, value in PAPER.items():
        assert measures[key] < value


def test_faults_reach_the_filter_as_they_are_called():
    num_steps, counts = 17 * 20, {}
    encoder, pose = np.diag([0.02, 0.02]) ** 2, np.diag([0.02, 0.02, 0.01]) ** 2
    for name, fault in FAULTS.items():
        started = Ekf()
        started.reset(Pose2D(0.0, 0.0, 0.0), start_covariance())
        channel = FaultyChannel(started, fault, np.random.default_rng(0))
        for k in range(num_steps):
            # Standing still from 30 s on, so that the time of silence is among them.
            time = 30.0 + (k + 1) / 17
            measurements = [Measurement(time, kind, np.zeros(2), encoder) for kind in ("encoder", "compass")]
            if k % 5 == 0:
                measurements.append(Measurement(time, "map", np.zeros(3), pose))
            channel.deliver(time, measurements)
            channel.compare(time, Pose2D(0.0, 0.0, 0.0))
        assert len(channel.errors) == num_steps
        assert np.max(channel.errors) < 0.3, name
        counts[name] = channel.ekf.counts
    assert counts["none"]["encoder"] == {"accepted": num_steps}
    assert counts["no map"]["map"] == {}
    assert 15 < counts["one in ten 3 s late"]["compass"]["too_old"] < 55
    assert 5 < counts["one in twenty wrong by metres"]["encoder"]["gated"] < 35
    assert 140 < counts["half of all missing"]["encoder"]["accepted"] < 200
    assert counts["all silent for 5 s"]["encoder"]["accepted"] == num_steps - 84
    late = counts["each up to 0.8 s late, out of order"]["encoder"]
    assert late["accepted"] > num_steps - 20
    assert "too_old" not in late
