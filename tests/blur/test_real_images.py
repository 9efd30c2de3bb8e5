"""Real labels and tuning forks, whose motion was tracked frame by frame; truth is used to judge, and for starts."""

import csv
import json

import cv2
import numpy as np
import pytest

from labdaemon.blur import Dot, InitialGuess, Patch, fit_sharp, make_textured_patch, measure, measure_frame
from labdaemon.flags import Flag


def grey(values, origin=(0, 0)):
    return Patch(values, np.zeros(values.shape, np.uint8), values < 64000, origin)


def cut(image, x, y, reach):
    left, top = max(int(x) - reach, 0), max(int(y) - reach, 0)
    return grey(image[top : int(y) + reach + 1, left : int(x) + reach + 1], (left, top))


@pytest.mark.slow
def test_real_frame(shared_data):
    folder = shared_data / "real_frame"
    still, moved = (
        cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED).astype(float) for name in ("sharp.png", "blurred.png")
    )
    with (folder / "truth.csv").open(encoding="utf-8") as file:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    rng = np.random.default_rng(4)
    sharps, patches, starts = [], [], []
    for row in rows:
        x, y = row["rest_x_px"] + rng.uniform(-1, 1), row["rest_y_px"] + rng.uniform(-1, 1)
        sharps.append(fit_sharp(Dot(x, y, 10.5, 10.5, 0.0), [cut(still, x, y, 32)]))
        x, y = row["centre_x_px"] + rng.uniform(-2, 2), row["centre_y_px"] + rng.uniform(-2, 2)
        patches.append(cut(moved, x, y, 36))
        starts.append(InitialGuess(np.array([x, y])))
    found = measure_frame(sharps, patches, initial_guesses=starts)
    error = np.array([np.hypot(*m.a_px) - row["semi_amplitude_px"] for m, row in zip(found, rows, strict=True)])
    floor = np.array([row["floor"] for row in rows])
    for one in (1, 2, 3):
        here = error[floor == one]
        assert abs(np.median(here)) <= 0.03
        assert 1.48 * np.median(np.abs(here - np.median(here))) <= 0.05
    pulls = (error / [m.sd_px for m in found])[floor > 0]
    assert 0.6 <= np.sqrt(np.mean(pulls**2)) <= 1.3
    assert np.abs(pulls).max() <= 3.0
    for one in np.flatnonzero(floor == 0):
        assert Flag.AT_REST in found[one].flags or error[one] + rows[one]["semi_amplitude_px"] <= 0.3


@pytest.mark.slow
def test_real_forks(shared_data):
    folder = shared_data / "real_forks"
    errors, pulls = {}, []
    for name, film in json.loads((folder / "truth.json").read_text()).items():
        blurred = grey(np.load(folder / f"{name}_blurred.npy").astype(float))
        for side, truth in film["targets"].items():
            sharp = grey(np.load(folder / f"{name}_{side}_sharp_turning.npy").astype(float))
            found = measure(make_textured_patch(sharp, tuple(truth["patch_xywh"])), blurred)
            errors[name, side] = float(np.hypot(*found.a_px)) - truth["rms_amp_sqrt2_px"]
            pulls.append(errors[name, side] / found.sd_px)
    pull = float(np.sqrt(np.mean(np.square(pulls))))
    print(f"ten forks: mean error {np.mean([*errors.values()]):+.4f} px, pulls {pull:.2f}")
    assert len(errors) == 10
    assert 0.6 <= pull <= 1.5
    assert max(abs(e) for e in errors.values()) <= 0.06, errors
