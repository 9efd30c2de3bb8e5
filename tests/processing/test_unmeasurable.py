"""A dot that is found at rest but whose fit has no solution keeps its row and says so; the others are measured."""

import numpy as np
import pytest
from scipy import ndimage

import labdaemon as ld
from labdaemon.blur import Dot, fit_sharp, unmeasurable_target
from labdaemon.flags import Flag
from labdaemon.processing import patches, prepare

CENTRES = [(60.3, 70.2), (160.1, 70.6), (260.4, 70.1)]


def sheet(seed: int) -> np.ndarray:
    y, x = np.mgrid[:140, :320]
    dark = np.max([np.clip(0.5 + 11.0 - np.hypot(x - u, y - v), 0, 1) for u, v in CENTRES], axis=0)
    values = ndimage.gaussian_filter(40000 * (1 - 0.9 * dark), 0.8)
    return (values + np.random.default_rng(seed).normal(0, 120, values.shape)).astype(np.uint16)


def test_one_dot_without_solution_is_one_flagged_row(monkeypatch: pytest.MonkeyPatch) -> None:
    def fit(dot, cuts):
        if abs(dot.x_px - 160) < 5:
            raise np.linalg.LinAlgError("singular")
        return fit_sharp(dot, cuts)

    monkeypatch.setattr(prepare, "fit_sharp", fit)
    table = ld.measure(sheet(1), sheet(2))
    assert [one.target for one in table] == ["T01", "T02", "T03"]
    assert table["T02"].flags == {Flag.POOR_FIT, Flag.NOT_FOUND}
    assert not np.isfinite(table["T02"].a_px).any()
    assert all(np.isfinite(table[name].a_px).all() for name in ("T01", "T03"))


@pytest.mark.parametrize("flags", [frozenset(), frozenset({Flag.SATURATED, Flag.NOT_FOUND})])
def test_an_unmeasurable_target_is_at_its_place_and_unusable(flags: frozenset[Flag]) -> None:
    target = unmeasurable_target(Dot(30.0, 40.0, 9.0, 8.0, 0.1, name="t"), flags)
    assert not target.usable
    assert target.centre_px == pytest.approx((30.0, 40.0))
    assert target.flags == (flags | {Flag.NOT_FOUND} if flags else {Flag.POOR_FIT, Flag.NOT_FOUND})


def test_a_patch_without_solution_is_refused_by_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_args, **_kwargs):
        raise np.linalg.LinAlgError("singular")

    monkeypatch.setattr(patches, "make_textured_patch", fail)
    with pytest.raises(ld.errors.DataError, match="patch 40,50,40,40 cannot be used"):
        ld.measure(sheet(1), sheet(2), patches=[(40, 50, 40, 40)])
