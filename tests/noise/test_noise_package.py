"""The docstring of the package lists what it has."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.noise import OctaveCascade, fit_curve, synthesise


def test_masks_and_arrays_of_one_axis_are_handled_and_wrong_shapes_refused() -> None:
    samples = synthesise(3000, 100.0, N=1e-3, seed=1)[:, 0]
    holes = samples.copy()
    holes[100:200] = np.nan
    masked = np.ma.masked_invalid(np.where(np.isnan(holes), 1e9, holes), copy=False)
    masked[100:200] = np.ma.masked
    curves = []
    for values in (holes[:, None], holes, masked):
        cascade = OctaveCascade(1, tau0=0.01)
        cascade.update(values)
        curves.append(cascade.result().sigma.tolist())
    assert curves[0] == curves[1] == curves[2]
    for wrong, valid, words in (
        (np.zeros((3, 500)), None, "transpose"),
        (np.zeros(500), None, "shape"),
        (np.zeros((500, 3)), np.ones(400, bool), "valid must have the shape"),
    ):
        with pytest.raises(ValueError, match=words):
            OctaveCascade(3, tau0=0.01).update(wrong, valid)


def test_a_fit_to_a_curve_alone_says_what_it_cannot_know() -> None:
    cascade = OctaveCascade(1, tau0=0.01)
    cascade.update(synthesise(3000, 100.0, N=1e-3, seed=1))
    assert fit_curve(cascade.result(), averaged=True)[0].caveats == ("unguarded",)
    known = fit_curve(cascade.result(), averaged=True, resolution=[0.0], kurtosis=[0.0])[0]
    assert known.caveats == ()
