"""GTSAM with the exported parameters on simulated data: NEES of preintegrated rotation and velocity.

A simulated record of a sensor at rest goes through imumon and `--format gtsam`. With these parameters a graph of
combined IMU factors, one per second, gets a rotation fix of 1 mrad and a velocity fix of 10 mm/s once a second.
One factor more preintegrates the time without a fix. NEES is that of rotation and velocity at its end.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from filters import report_of_samples

from imumon.documents.program_settings import settings_document
from imumon.model.report import Report
from imumon.noise import synthesise
from imumon.record.filter_report_builder import filter_report

TRUE = {"N": (6.1e-5, 1.4e-3), "B": (2.4e-5, 4e-4), "K": (1e-6, 2e-5)}  # gyroscope, accelerometer; SI
RATE = 5.0  # Hz, of the samples that are preintegrated
FIX = (1e-3, 1e-2)  # rad, m/s
GRAVITY = 9.80665
HORIZONS = (10, 60, 300)


def noise(seconds: float, rate: float, seed: int) -> np.ndarray:
    """Return the noise of gyroscope and accelerometer, (n, 6) SI."""
    strengths = {name: np.repeat(values, 3) for name, values in TRUE.items()}
    return synthesise(round(seconds * rate), rate, **strengths, seed=np.random.default_rng([20_263, seed]))


def report_of_record(hours: float = 5.0, rate: float = 10.0, seed: int = 0) -> Report:
    """Return the report of a simulated record."""
    return report_of_samples(noise(hours * 3600.0, rate, seed), rate, "deltas")


def exported(report: Report, horizon_s: float) -> Any:
    """Return the parameters that the exported code makes, with bounds where the record does not show a number."""
    names: dict[str, Any] = {}
    exec(settings_document("gtsam", report, filter_report(report, horizon_s), bounds=True), names)
    return names["params"]


def plain(report: Report, horizon_s: float) -> Any:
    """Return parameters with N and K alone."""
    params = exported(report, horizon_s)
    assumed = {name: channel.assumed for name, channel in filter_report(report, horizon_s).channels.items()}
    for sensor, call in (("accel", params.setBiasAccCovariance), ("gyro", params.setBiasOmegaCovariance)):
        call(np.eye(3) * max(assumed[f"{sensor}/{axis}"].K for axis in "xyz") ** 2)
    return params


def one_run(
    params: Any, seed: int, aided_s: int, horizons: tuple[int, ...], gravity: float = GRAVITY
) -> np.ndarray:
    """Return NEES of rotation and velocity, each over its three axes, (2, h).

    Without gravity the rotation does not show in the velocity: every channel is in the reference scenario.
    """
    import gtsam
    from gtsam.symbol_shorthand import B, V, X

    rng = np.random.default_rng([20_264, seed])
    samples = noise(aided_s + max(horizons), RATE, 1_000 + seed)
    samples[:, 5] += gravity
    params.n_gravity = np.array([0.0, 0.0, -gravity])
    steps, dt = round(RATE), 1.0 / RATE
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    bias, rest = gtsam.imuBias.ConstantBias(), gtsam.Pose3()
    pose_noise = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([FIX[0], 1.0], 3))
    velocity_noise = gtsam.noiseModel.Isotropic.Sigma(3, FIX[1])

    def integrated(first: int, last: int) -> Any:
        made = gtsam.PreintegratedCombinedMeasurements(params, bias)
        for row in samples[first:last]:
            made.integrateMeasurement(row[3:], row[:3], dt)
        return made

    def node(key: int) -> None:
        values.insert(X(key), rest)
        values.insert(V(key), np.zeros(3))
        values.insert(B(key), bias)

    node(0)
    graph.add(gtsam.PriorFactorConstantBias(B(0), bias, gtsam.noiseModel.Isotropic.Sigma(6, 1.0)))
    for k in range(aided_s + 1):
        if k:
            node(k)
            made = integrated((k - 1) * steps, k * steps)
            graph.add(gtsam.CombinedImuFactor(X(k - 1), V(k - 1), X(k), V(k), B(k - 1), B(k), made))
        fix = gtsam.Pose3(gtsam.Rot3.Expmap(FIX[0] * rng.standard_normal(3)), rng.standard_normal(3))
        graph.add(gtsam.PriorFactorPose3(X(k), fix, pose_noise))
        graph.add(gtsam.PriorFactorVector(V(k), FIX[1] * rng.standard_normal(3), velocity_noise))
    for i, horizon in enumerate(horizons, start=aided_s + 1):
        node(i)
        made = integrated(aided_s * steps, (aided_s + horizon) * steps)
        graph.add(gtsam.CombinedImuFactor(X(aided_s), V(aided_s), X(i), V(i), B(aided_s), B(i), made))
    found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    marginals = gtsam.Marginals(graph, found)
    nees = np.empty((2, len(horizons)))
    for i in range(len(horizons)):
        key = aided_s + 1 + i
        rotation = gtsam.Rot3.Logmap(found.atPose3(X(key)).rotation())
        covariance = marginals.marginalCovariance(X(key))[:3, :3]
        nees[0, i] = rotation @ np.linalg.solve(covariance, rotation) / 3.0
        velocity = found.atVector(V(key))
        nees[1, i] = velocity @ np.linalg.solve(marginals.marginalCovariance(V(key)), velocity) / 3.0
    return nees


def nees_of(
    params: Any, runs: int, gravity: float, aided_s: int = 900, horizons: tuple[int, ...] = HORIZONS
) -> np.ndarray:
    """Return the NEES of every run, (runs, 2, h)."""
    return np.array([one_run(params, seed, aided_s, horizons, gravity) for seed in range(runs)])
