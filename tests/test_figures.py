"""Printed figures: what stands on the axes, what a legend may cover, and that the same data give the same bytes."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import xml.etree.ElementTree as ET
from itertools import pairwise

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from fosopt.report.figures import COLUMN, PAGE, draw, journal_style, picture
from fosopt.report.panels import Curve, Mark, Panel
from fosopt.report.typeset import as_html, as_mathtext

FREQUENCY = np.geomspace(0.1, 1000, 300)


def bode(**changes) -> tuple[Panel, Panel]:
    """Magnitude and phase of a first-order lag, beside a second curve."""
    s = 1j * FREQUENCY / 10
    curves = {"lag": 1 / (1 + s), "twice": 1 / (1 + s) ** 2}
    decibels = tuple(Curve(FREQUENCY, 20 * np.log10(abs(h)), name) for name, h in curves.items())
    degrees = tuple(Curve(FREQUENCY, np.degrees(np.angle(h)), name) for name, h in curves.items())
    options = {"x_scale": "log", **changes}
    return (
        Panel("frequency [Hz]", "|θ_m/t_m| [dB]", decibels, marks=(Mark("0 dB", y=0.0),), **options),
        Panel("frequency [Hz]", "phase [deg]", degrees, **options),
    )


def drawn(*panels: Panel, columns: int = 1) -> Figure:
    with journal_style():
        figure = draw(panels, columns)
        figure.draw_without_rendering()
    return figure


def one(*curves: Curve, **options) -> Panel:
    return Panel("x [m]", "y [-]", curves, **options)


def line(label: str = "", style: str = "line", shift: float = 0.0) -> Curve:
    x = np.linspace(0, 10, 50)
    return Curve(x, x + shift, label, style)


@pytest.mark.parametrize(
    ("text", "html", "mathematics"),
    [
        ("θ_m(jω) [dB]", "<i>θ</i><sub>m</sub>(<i>jω</i>) [dB]", "$θ_{m}$($jω$) [dB]"),
        ("1 − J̄_k", "1 − <i>J̄</i><sub>k</sub>", r"1 − $\bar{J}_{k}$"),
        ("ẏ_{2110}", "<i>ẏ</i><sub>2110</sub>", r"$\dot{y}_{2110}$"),
        ("J_truss", "<i>J</i><sub>truss</sub>", r"$J_{\mathrm{truss}}$"),
        ("10^{-3}", "10<sup>−3</sup>", r"$\mathrm{10}^{-3}$"),
        ("[rad^2/s]", "[rad<sup>2</sup>/s]", "[rad$^{2}$/s]"),
        ("J [kg m^2]", "<i>J</i> [kg m<sup>2</sup>]", r"$J$ [kg $\mathrm{m}^{2}$]"),
        ("|G|^2", "|<i>G</i>|<sup>2</sup>", "|$G$|$^{2}$"),
        ("natural_frequency", "natural_frequency", "natural_frequency"),
        ("a mirror's mode, e.g. 20 s", "a mirror's mode, e.g. 20 s", "a mirror's mode, e.g. 20 s"),
        ("$5 <b>&", "$5 &lt;<i>b</i>&gt;&amp;", r"\$5 <$b$>&"),
        ("a_{<$}", "<i>a</i><sub>&lt;$</sub>", r"$a_{<\$}$"),
    ],
)
def test_a_plain_label_is_set_with_its_scripts(text, html, mathematics):
    assert as_html(text) == html
    assert as_mathtext(text) == mathematics


def test_variables_stand_upright_where_that_is_asked_for():
    assert as_html("θ_m of x", slant=False) == "θ<sub>m</sub> of x"


def test_axes_have_their_labels_units_and_scales():
    figure = drawn(*bode())
    magnitude, phase = figure.axes
    assert (magnitude.get_xscale(), magnitude.get_yscale()) == ("log", "linear")
    assert magnitude.get_ylabel() == "|$θ_{m}$/$t_{m}$| [dB]"
    assert (phase.get_xlabel(), phase.get_ylabel()) == ("frequency [Hz]", "phase [deg]")
    assert figure.get_size_inches()[0] == COLUMN


def test_an_abscissa_that_is_the_same_below_is_labelled_once():
    magnitude, phase = drawn(*bode()).axes
    assert magnitude.get_xlabel() == ""
    assert [
        any(t.get_visible() and t.get_text() for t in axes.get_xticklabels()) for axes in (magnitude, phase)
    ] == [
        False,
        True,
    ]
    upper, lower = drawn(*bode()[:1], *bode(x_range=(1.0, 10.0))[1:]).axes
    assert upper.get_xlabel() == lower.get_xlabel() == "frequency [Hz]"


def test_a_logarithmic_axis_has_minor_ticks_and_plain_numbers():
    axes = drawn(*bode()).axes[1]
    assert len(axes.xaxis.get_minorticklocs()) > 20
    texts = [label.get_text() for label in axes.get_xticklabels()]
    assert {"0.1", "1", "10", "100", "1000"} <= set(texts)


def test_a_phase_is_read_in_parts_of_a_turn():
    ticks = drawn(*bode()).axes[1].get_yticks()
    assert set(np.diff(ticks)) == {45.0}


def test_a_range_is_kept_and_the_other_axis_fits_what_is_seen():
    axes = drawn(one(line(), x_range=(2.0, 4.0))).axes[0]
    assert axes.get_xlim() == (2.0, 4.0)
    low, high = axes.get_ylim()
    assert 1.8 < low < 2.1 < 3.9 < high < 4.2


@pytest.mark.parametrize(
    ("y", "scale"), [([3.0, 3.0], "linear"), ([-1.0, 0.0], "log"), ([np.nan] * 2, "linear")]
)
def test_curves_without_extent_are_drawn_all_the_same(y, scale):
    low, high = drawn(one(Curve(np.array([0.0, 1.0]), np.array(y)), y_scale=scale)).axes[0].get_ylim()
    assert np.isfinite([low, high]).all()
    assert low < high


def test_curves_differ_by_color_and_by_dash():
    lines = drawn(one(*(line(f"case {k}", shift=k) for k in range(7)))).axes[0].lines
    assert len({each.get_color() for each in lines}) == 7
    dashes = [each._dash_pattern for each in lines]
    assert all(dash != following for dash, following in pairwise(dashes))


def test_a_label_looks_the_same_everywhere_and_a_branch_like_what_it_continues():
    panels = (one(line("a"), line("b", shift=1)), one(line("b"), line(shift=2), line("a", shift=3)))
    first, second = (axes.lines for axes in drawn(*panels).axes)
    assert [each.get_color() for each in second] == [first[1].get_color()] * 2 + [first[0].get_color()]


def test_styles_are_what_they_say():
    axes = drawn(
        one(line("a", "points"), line("b", "crosses"), line("c", "dashed"), line("d", "stems"))
    ).axes[0]
    points, crosses, dashed, stems = axes.lines
    assert (points.get_marker(), points.get_linestyle(), points.get_markerfacecolor()) == (
        "o",
        "None",
        "none",
    )
    assert crosses.get_marker() == "x"
    assert dashed.get_linestyle() == "--"
    assert stems.get_marker() == "o"
    assert len(axes.collections[0].get_paths()) == 50


def test_stems_on_a_logarithmic_axis_stand_on_its_lower_end():
    axes = drawn(one(Curve(np.arange(3.0), np.array([1e-9, 1e-5, 1e-7]), "", "stems"), y_scale="log")).axes[0]
    feet = [path.vertices[0, 1] for path in axes.collections[0].get_paths()]
    assert feet == pytest.approx([axes.get_ylim()[0]] * 3)


def test_marks_are_lines_across():
    axes = drawn(one(line(), marks=(Mark("limit", y=12.0), Mark(y=-2.0), Mark("mirror", x=3.0)))).axes[0]
    _, upper, lower, across = axes.lines
    assert list(upper.get_ydata()) == [12.0, 12.0]
    assert lower.get_linestyle() == upper.get_linestyle() != across.get_linestyle()
    assert list(across.get_xdata()) == [3.0, 3.0]
    assert axes.get_ylim()[0] < -2 < 12 < axes.get_ylim()[1]


def test_a_legend_covers_no_curve():
    corner = one(line("rising"))
    full = one(
        *(Curve(np.linspace(0, 1, 200), np.sin(40 * k * np.linspace(0, 1, 200)), f"wave {k}") for k in (1, 2))
    )
    for panel, inside in ((corner, True), (full, False)):
        axes = drawn(panel).axes[0]
        box = axes.get_legend().get_window_extent()
        assert not any(
            each.get_transform().transform_path(each.get_path()).intersects_bbox(box, filled=False)
            for each in axes.lines
        )
        assert bool(box.y0 < axes.bbox.y1) is inside


def test_panels_with_the_same_curves_share_a_legend():
    figure = drawn(*bode())
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["lag", "twice", "0 dB"]
    assert all(axes.get_legend() is None for axes in figure.axes)


def test_a_wide_panel_takes_a_row_and_both_columns():
    figure = drawn(one(line(), wide=True), one(line()), one(line()), columns=2)
    wide, left, right = (axes.get_subplotspec() for axes in figure.axes)
    assert figure.get_size_inches()[0] == PAGE
    assert (wide.colspan.start, wide.colspan.stop, left.rowspan.start, right.rowspan.start) == (0, 2, 1, 1)


def test_a_label_longer_than_its_axes_is_broken():
    panels = [
        Panel("x", "a label far longer than a panel is high, with a unit [N m]", (line(),), "word " * 30)
    ] * 3
    for axes in drawn(*panels).axes:
        assert "\n[N m]" in axes.get_ylabel()
        assert "\n" in axes.get_title()


def test_equal_axes_have_one_scale():
    angle = np.linspace(0, 2 * np.pi, 100)
    axes = drawn(one(Curve(np.cos(angle), 3 * np.sin(angle)), equal=True)).axes[0]
    width, height = np.diff(axes.get_xlim())[0], np.diff(axes.get_ylim())[0]
    # Matplotlib leaves limits alone that are right within half a percent.
    assert width / height == pytest.approx(axes.bbox.width / axes.bbox.height, rel=5e-3)


def test_a_panel_of_equal_axes_fills_its_column():
    square = one(line(), equal=True, x_range=(0.0, 10.0), y_range=(0.0, 10.0))
    for columns, count in ((1, 1), (3, 3), (3, 6)):
        figure = drawn(*[square] * count, columns=columns)
        for axes in figure.axes:
            box, cell = axes.get_position(), axes.get_position(original=True)
            assert box.width / cell.width > 0.85
            assert box.height / cell.height > 0.85


def test_a_panel_without_curves_is_drawn():
    assert drawn(one(), one(Curve(np.empty(0), np.empty(0)))).axes[0].get_xlim() == (0.0, 1.0)


SCRIPT = """
import hashlib, sys
sys.path.insert(0, sys.argv[1])
from test_figures import bode
from fosopt.report.figures import picture
for kind, data in sorted(picture(bode()).files.items()):
    print(kind, hashlib.sha256(data).hexdigest())
assert "matplotlib.pyplot" not in sys.modules
"""


def test_the_same_panels_give_the_same_bytes_in_another_process(request):
    here = [
        f"{kind} {hashlib.sha256(data).hexdigest()}" for kind, data in sorted(picture(bode()).files.items())
    ]
    with mpl.rc_context({"font.size": 20, "axes.facecolor": "red"}):
        changed = picture(bode())
    tests = str(request.path.parent)
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, tests],
        capture_output=True,
        text=True,
        check=True,
        cwd=request.path.parents[1],
    )
    assert done.stdout.splitlines() == here
    assert changed.files == picture(bode()).files


def test_files_are_what_they_are_called():
    image = picture(bode())
    root = ET.fromstring(image.files["svg"])
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert root.get("width") == f"{COLUMN * 72:g}pt"
    assert b"<text" not in image.files["svg"]
    assert b"<dc:date" not in image.files["svg"]
    assert image.files["png"].startswith(b"\x89PNG")
    pixels = int.from_bytes(image.files["png"][16:20], "big")
    assert pixels == 200 * COLUMN == 200 * image.width


def test_drawing_leaves_the_settings_alone():
    before = dict(mpl.rcParams)
    picture(bode())
    assert dict(mpl.rcParams) == before


@pytest.mark.parametrize(
    ("x", "y", "fault"),
    [
        (np.zeros(3), np.zeros(4), "one length"),
        (np.zeros((2, 2)), np.zeros((2, 2)), "two vectors"),
        (np.zeros(2), np.zeros(2, dtype=complex), "complex"),
    ],
)
def test_a_curve_that_is_none_is_refused(x, y, fault):
    with pytest.raises(ValueError, match=fault):
        Curve(x, y, "gain")
