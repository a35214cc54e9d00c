"""Experiment of Nguyen et al. (2021): drives, measures, tables and figures."""

import itertools
import math
from collections import Counter

import numpy as np
import pytest

from lidarnaut.benchmarks.documents import ekf_fusion as experiment
from lidarnaut.benchmarks.documents.__main__ import main
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.localization.ekf import Ekf, Measurement
from lidarnaut.envs.localization.fusion import start_covariance

OF_READINGS = "", " to the planned route", " of the true pose to the planned route"


def make_drive(errors, covariance=None, straights=0.0, ahead=0.0):
    truth = np.tile([1.0, 2.0, math.pi - 0.001], (len(errors), 1))
    covariances = {"full": np.tile(np.eye(3) if covariance is None else covariance, (len(errors), 1, 1))}
    time, estimated = np.arange(len(errors), dtype=float), {"full": truth + errors}
    directions = np.broadcast_to(straights, len(errors))
    planned = truth + (0.0, ahead, 0.0)
    return experiment.RouteDrive(
        "kinematic", 0, "completed", 0, time, truth, directions, planned, estimated, covariances
    )


def test_measures_are_equations_11_and_12():
    errors = np.array([[0.03, 0.0, 0.01], [0.0, -0.04, 0.0], [0.0, 0.0, -0.02], [0.0, 0.0, 0.0]])
    for factor in (1.0, 2.0):
        measures = make_drive(factor * errors, straights=[0.0, 0.0, np.nan, math.pi / 2]).measure("full")
        assert measures["heading RMSE [deg]"] == pytest.approx(factor * math.degrees(math.sqrt(0.0005 / 4)))
        assert measures["greatest heading error [deg]"] == pytest.approx(factor * math.degrees(0.02))
        for key, value in {"position RMSE": 25.0, "greatest x error": 30.0, "greatest y error": 40.0}.items():
            assert measures[f"{key} [mm]"] == pytest.approx(factor * value)
        # Of the three straight periods, one has an error across.
        assert measures["mean error across on straights [mm]"] == pytest.approx(factor * 40.0 / 3)
        assert measures["RMS error across on straights [mm]"] == pytest.approx(factor * 40.0 / math.sqrt(3))


def test_errors_to_the_route_are_distances_to_the_pose_planned_for_the_same_time():
    drive = make_drive(np.tile([0.003, 0.004, 0.01], (4, 1)), straights=math.pi / 2, ahead=0.02)
    readings = drive.readings("full")
    found = {of: readings[f"mean error along on straights{of} [mm]"] for of in OF_READINGS}
    assert found == pytest.approx(dict(zip(OF_READINGS, (4.0, 16.0, 20.0))))
    found = {of: readings[f"mean error across on straights{of} [mm]"] for of in OF_READINGS}
    assert found == pytest.approx(dict(zip(OF_READINGS, (3.0, 3.0, 0.0))))
    found = {of: readings[f"greatest distance{of} [mm]"] for of in OF_READINGS}
    assert found == pytest.approx(dict(zip(OF_READINGS, (5.0, math.hypot(3.0, 16.0), 20.0))))
    assert readings["heading RMSE to the planned route [deg]"] == pytest.approx(math.degrees(0.01))
    assert [key for key in readings if "NEES" in key] == ["NEES []"]


def test_nees_tells_honest_from_overconfident():
    covariance = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 0.5]]) * 1e-4
    errors = np.random.default_rng(0).multivariate_normal(np.zeros(3), covariance, (20, 400))
    for scale, nees, within in ((1.0, 3.0, 0.95), (0.5, 6.0, 0.01)):
        drives = [make_drive(error, scale * covariance) for error in errors]
        assert np.mean([drive.measure("full")["NEES []"] for drive in drives]) == pytest.approx(nees, rel=0.05)
        assert experiment.nees_within(drives, "full") == pytest.approx(within, abs=0.04)


def test_a_quick_run_gives_figures_and_pictures_and_beats_the_paper(tmp_path, capsys):
    figures = {one.item: one for one in main("ekf_fusion", pictures=tmp_path, jobs=1, quick=True)}
    for (key, value), of in itertools.product(experiment.PAPER.items(), OF_READINGS[:2]):
        item, _, unit = key[:-1].partition(" [")
        figure = figures[f"{item}{of}, full fusion, kinematic"]
        assert (figure.document, figure.unit) == (value, unit)
        assert figure.median < value or "across" in key
        assert figures[f"{item}, encoder alone, kinematic"].document is None
        assert figures[f"{item}{OF_READINGS[2]}, full fusion, kinematic"].document is None
    assert "It is not known which errors the paper means." in " ".join(capsys.readouterr().out.split())
    assert figures["route completed without contact, kinematic"].median == 1.0
    for label in experiment.LABELS.values():
        assert figures[f"position RMSE, compass noise 0.69 deg, magnets: {label}"].median > 0.0
    assert figures["position RMSE, fault: none"].median < figures["position RMSE, fault: no encoders"].median
    for name in ("position", "heading", "errors"):
        assert (tmp_path / f"ekf_fusion_{name}.png").stat().st_size > 10_000


def test_faults_reach_the_filter_as_they_are_called():
    num_steps, verdicts = 17 * 20, {}
    encoder, pose = np.diag([0.02, 0.02]) ** 2, np.diag([0.02, 0.02, 0.01]) ** 2
    for name, fault in experiment.FAULTS.items():
        started, errors = Ekf(), []
        started.reset(Pose2D(0.0, 0.0, 0.0), start_covariance())
        channel = experiment.FaultyChannel(started, fault, np.random.default_rng(0))
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
