"""The page of a sweep in a headless Chromium: it loads, fits, and draws the numbers of the run directory."""

from __future__ import annotations

import json

import numpy as np
import pytest
from headless import DESKTOP, PHONE
from test_sweep_study import run_in, sweep_text

LINE = """\
sweep:
  axes:
    - quantity: mirror_inertia_ratio
      log: {from: 0.1 %, to: 20 %, points: 21}
  outputs: [stable, jitter_total, one_minus_separation, pole_zero_separation, effective_modal_reaction_inertia]
  boundary: {along: mirror_inertia_ratio}
"""
MAP = LINE.replace(
    "  outputs",
    "    - quantity: mirror_frequency\n      linear: {from: 10 Hz, to: 40 Hz, points: 4}\n  outputs",
)
FAST = ("crossover: 100 Hz", "crossover: 230 Hz")


@pytest.fixture(scope="module", params=[LINE, MAP], ids=["line", "map"])
def sweep(request, tmp_path_factory):
    return run_in(tmp_path_factory.mktemp("sweep") / "run", sweep_text(request.param, FAST, bays=8))


def show(browser, sweep, width):
    """Load the page and wait until its last figure is drawn."""
    browser.visit(sweep.out / "report.html", width)
    browser.wait("[...document.querySelectorAll('.plot')].at(-1)?.querySelector('.main-svg')")


def traces(browser, figure):
    """Data of a figure as the page drew it, compressed arrays undone."""
    return json.loads(
        browser.evaluate(f"""JSON.stringify(document.getElementById('{figure}').data.map(
            (each) => ({{ type: each.type, mode: each.mode, x: [...each.x], y: [...each.y],
                          z: each.z && each.z.map((row) => [...row]) }})))""")
    )


@pytest.mark.parametrize("width", [DESKTOP, PHONE])
def test_the_page_loads_without_a_network_and_fits_the_window(browser, sweep, width):
    show(browser, sweep, width)
    wanted = browser.evaluate("document.querySelectorAll('.plot').length")
    assert wanted == 2 + 3 + 2  # scalars, modes, and two of these against the modes' reaction inertia
    assert browser.evaluate("document.querySelectorAll('.plot .main-svg').length") >= wanted
    assert browser.evaluate("document.documentElement.scrollWidth") <= width


def test_scalars_are_drawn_as_they_were_computed(browser, sweep):
    show(browser, sweep, DESKTOP)
    drawn = traces(browser, "scalar-1")[0]
    jitter, ratio = sweep.arrays["jitter_total"] * 1e6, sweep.arrays["mirror_inertia_ratio"]
    shape = sweep.run["shape"]
    if len(shape) == 1:
        assert drawn["x"] == pytest.approx(ratio, rel=1e-6)
        found = np.array(drawn["y"], dtype=float)
    else:
        assert drawn["type"] == "heatmap"
        assert drawn["y"] == pytest.approx(ratio.reshape(shape)[:, 0], rel=1e-6)
        assert drawn["x"] == pytest.approx([10, 20, 30, 40], rel=1e-6)
        found = np.array(drawn["z"], dtype=float).ravel()
        # Over decades colors are logarithms.
        if np.nanmax(jitter) > 50 * np.nanmin(jitter):
            found = 10**found
    assert np.array_equal(np.isnan(found), np.isnan(jitter))
    assert 0 < np.isnan(found).sum() < found.size
    np.testing.assert_allclose(found, jitter, rtol=1e-5)


def test_the_boundary_is_drawn_and_listed(browser, sweep):
    show(browser, sweep, DESKTOP)
    found = [each["at"]["mirror_inertia_ratio"] for each in sweep.run["boundaries"]]
    assert found
    rows = browser.evaluate("document.querySelectorAll('#boundaries-table tbody tr').length")
    assert rows == len(found)
    if len(sweep.run["shape"]) == 1:
        shapes = browser.evaluate(
            "document.getElementById('scalar-1').layout.shapes.map((s) => s.x0 ?? s.y0)"
        )
        assert sorted(map(float, shapes)) == pytest.approx(sorted(found), rel=1e-6)
    else:
        contour = [y for each in traces(browser, "scalar-0")[1:] for y in each["y"]]
        assert sorted(contour) == pytest.approx(sorted(found), rel=1e-6)


def test_separation_is_drawn_against_reaction_inertia_mode_by_mode(browser, sweep):
    show(browser, sweep, DESKTOP)
    place = [o["name"] for o in sweep.run["outputs"] if len(o["shape"]) == 2].index("one_minus_separation")
    curves = traces(browser, f"reaction-{place}")
    separation, reaction = (
        sweep.arrays[name] for name in ("one_minus_separation", "effective_modal_reaction_inertia")
    )
    assert len(curves) == separation.shape[1]
    rows = [
        k for k in range(separation.shape[0]) if k % (separation.shape[0] // len(curves[0]["x"]) or 1) == 0
    ]
    for mode, curve in enumerate(curves):
        y = np.array(curve["y"], dtype=float)
        np.testing.assert_allclose(y, np.abs(separation[rows, mode]), rtol=1e-5)
        np.testing.assert_allclose(np.array(curve["x"], dtype=float), reaction[rows, mode], rtol=1e-5)
