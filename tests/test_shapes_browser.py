"""Mode shapes and the verdict on a requirement line in a report, in a headless Chromium without a network."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fake_report as fake
import numpy as np
import pytest
from headless import DESKTOP, PHONE, Browser

from fosopt.report import write_report

HOSTILE = "<b>bold</b><img src=x onerror=alert(1)>"
LINE = {"frequency_hz": [1.0, 10.0, 100.0], "rms": [5e-6, 20e-6, 60e-6]}
EXCEEDED = {"met": False, "frequency_hz": 10.0, "reached": 30e-6, "allowed": 20e-6, "excess": 10e-6}
MET = {"met": True, "frequency_hz": 100.0, "reached": 45e-6, "allowed": 60e-6, "excess": -15e-6}


def opened(
    browser: Browser, run: dict[str, Any], folder: Path, width: int = DESKTOP, fragment: str = ""
) -> None:
    path = folder / "report.html"
    write_report(run, path)
    browser.open(path, width, fragment)


def run_of(*points: dict[str, Any], **changes: Any) -> dict[str, Any]:
    return fake.fake_run() | {"points": list(points), "comparison": []} | changes


def look_at(browser: Browser, key: str) -> None:
    """Show another point of the report that is open."""
    browser.evaluate(f"location.hash = '#point={key}'")
    browser.wait(f"document.querySelector('#announcement').textContent.startsWith('Point {key} selected')")


def text(browser: Browser, selector: str) -> str:
    return browser.evaluate(f"document.querySelector({json.dumps(selector)}).innerText").replace(
        "\u00a0", " "
    )


def chosen(browser: Browser) -> list[str]:
    """Numbers of the highlighted rows and of the pressed buttons."""
    return browser.evaluate(
        "[...document.querySelectorAll('#modes tr.current th, #modes [aria-pressed=true]')].map((e) => e.innerText)"
    )


def drawn(browser: Browser, trace: int) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the lines of a trace of the shape, without what parts them."""
    x, y = browser.evaluate(
        f"(({{ x, y }}) => [x, y].map((each) => each.filter((e) => e !== null)))"
        f"(document.getElementById('shape').data[{trace}])"
    )
    return np.array(x), np.array(y)


def encoded(*values: float) -> str:
    return b64encode(np.rint(127 * np.array(values)).astype(np.int8).tobytes()).decode()


# ---- choosing a mode ----


@pytest.mark.parametrize("width", [DESKTOP, PHONE])
def test_a_click_on_a_row_draws_the_shape_of_its_mode(browser: Browser, tmp_path: Path, width: int):
    opened(browser, run_of(fake.point(3, 8.0)), tmp_path, width)
    # The mode that makes most of the jitter.
    assert chosen(browser) == ["3", "3"]
    assert "Shape of mode 3, 19.12 Hz: structure and mirror together" in text(browser, "#shape-caption")
    before = drawn(browser, 1)
    place = browser.evaluate("""(() => {
        const cell = document.querySelector('#modes tbody tr:nth-child(5) td:nth-child(3)');
        cell.scrollIntoView({ block: 'center' });
        const { left, top, height } = cell.getBoundingClientRect();
        return [left + 5, top + height / 2];
    })()""")
    browser.click(*place)
    browser.wait("document.querySelector('#modes tr.current th').innerText === '5'")
    assert chosen(browser) == ["5", "5"]
    assert "Shape of mode 5, " in text(browser, "#shape-caption")
    assert "Shape of mode 5 drawn" in text(browser, "#announcement")
    assert not np.array_equal(before[1], drawn(browser, 1)[1])


def test_a_mode_is_chosen_by_keyboard(browser: Browser, tmp_path: Path):
    opened(browser, run_of(fake.point(3, 8.0), fake.point(4, 9.0)), tmp_path)
    browser.evaluate("document.querySelector('#modes tr.current button').focus()")
    for key, mode in (("ArrowDown", "4"), ("ArrowUp", "3"), ("End", "9"), ("ArrowDown", "9"), ("Home", "1")):
        browser.press(key)
        assert chosen(browser) == [mode, mode]
        assert browser.evaluate("document.activeElement.innerText") == mode
    browser.press("Tab")
    assert browser.evaluate("document.activeElement.innerText") == "2"
    browser.press("Enter")
    assert chosen(browser) == ["2", "2"]
    label = browser.evaluate("document.activeElement.getAttribute('aria-label')")
    assert label == "Draw the shape of mode 2"
    # The last mode has no shape, and no button; a click on its row changes nothing.
    assert browser.evaluate("document.querySelectorAll('#modes tbody button').length") == 9
    browser.evaluate("document.querySelector('#modes tbody tr:last-child').click()")
    assert chosen(browser) == ["2", "2"]
    assert "Rows without a button" in text(browser, "#modes-caption")
    # The mode stays the same when another point is chosen.
    look_at(browser, "004")
    assert chosen(browser) == ["2", "2"]
    assert "Shape of mode 2, " in text(browser, "#shape-caption")


# ---- what is drawn ----

MODES = [{"index": 1, "frequency_hz": 7.5, "pole_zero_separation": 1.0}]


def kinds() -> dict[str, dict[str, Any]]:
    """Details of a planar truss, one with a short bar, a spatial one, a beam, a chain and a model without geometry."""
    planar = {
        "nodes": [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [1.0, 1.0]],
        "bars": [[0, 1], [1, 2], [1, 3]],
        "battens": [[0, 3]],
        "areas": [4e-5, 2e-5, 1e-5],
        "names": [HOSTILE] * 3,
    }
    short = {"nodes": [[0.0, 0.0], [0.1, 0.0], [9.0, 0.0]], "bars": [[0, 1], [1, 2]], "areas": [1e-5, 1e-5]}
    spatial = fake.spatial_run()["points"][0]["detail"]["truss"]  # type: ignore[index]
    beam = {"kind": "beam", "length": 8.0, "held": True, "stations": {"hub": 0.0, "tip": 8.0}}
    bodies = {"bodies": [HOSTILE, "b"], "inertias": [1.0, 2.0], "springs": [3.0]}

    def mirror(at: str, *xyz: float) -> list[dict[str, Any]]:
        return [{"kind": "mirror", "port": HOSTILE, "at": at, "xyz": list(xyz)}]

    def shape(mirror: float, port: float, *values: float) -> dict[str, Any]:
        return {"values": [encoded(*values)], "mirror": [mirror], "port": [port]}

    across = shape(0.125, -2.0, 0, 0, 0, 1, 0, -0.5, -0.25, 0.5, 0, -0.5)
    along_z = shape(1.0, 1.0, *[0, 0, 1] * len(spatial["nodes"]))
    nothing = {"truss": None, "structure": None}
    return {
        "000": {"truss": planar, "shapes": across, "places": mirror("", 2.0, 0.0)},
        "001": {"truss": short, "shapes": shape(0.0, 0.0, 0, 0, 0, 1, 0, 0), "places": []},
        "002": {"truss": spatial, "shapes": along_z, "places": []},
        "003": nothing
        | {"structure": beam, "shapes": shape(0.5, 0.25, 0, 0.2, 1), "places": mirror("tip", 6.0, 0.0)},
        "004": nothing
        | {
            "structure": {"kind": "chain", "held": False, **bodies},
            "shapes": shape(-4.0, 1.0, -0.5, 1),
            "places": mirror("b", 0.0, 0.0),
        },
        "005": nothing | {"shapes": None},
        **{f"{6 + k:03d}": of_three_modes(planar, rows) for k, (rows, _) in enumerate(FIRST)},
    }


# Share of jitter, J̄ and separation of the modes one to three, and which is shown first.
FIRST = (
    (((0.1, 0.2, 1.0), (None, 0.9, None), (0.4, 0.1, 1.0)), "3"),
    (((0.1, 0.2, 1.0), (None, 0.9, None), (0.4, 1e-30, 1.0)), "1"),
    (((None, 0.01, 1.0), (None, 0.9, None), (None, -0.02, 1.0)), "3"),
    (((None, 0.05, None), (None, 0.9, None), (None, 0.02, None)), "1"),
    (((None, 0.3, None), (None, 0.7, None), (None, 0.5, None)), "2"),
)


def of_three_modes(truss: dict[str, Any], rows: Any) -> dict[str, Any]:
    names = ("jitter_share", "effective_modal_reaction_inertia", "pole_zero_separation")
    modes = [{"index": k + 1} | dict(zip(names, row, strict=True)) for k, row in enumerate(rows)]
    known = {"values": [encoded(*[0, 1] * 4)] * 3, "mirror": [1.0] * 3, "port": [1.0] * 3}
    return {"truss": truss, "places": [], "modes": modes, "shapes": known}


@pytest.fixture(scope="module")
def all_kinds(chromium: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A report of a point of each kind, left open for the tests that follow each other."""
    chromium.troubles.clear()
    points = [
        fake.point(k, 8.0) | {"detail": {"modes": MODES} | detail}
        for k, detail in enumerate(kinds().values())
    ]
    opened(chromium, run_of(*points), tmp_path_factory.mktemp("kinds"), PHONE)
    yield chromium
    assert not chromium.troubles, "\n".join(chromium.troubles)


def test_a_truss_is_drawn_as_it_moves_beside_itself_at_rest(all_kinds: Browser):
    look_at(all_kinds, "000")
    x, y = drawn(all_kinds, 0)
    assert (x.tolist(), y.tolist()) == ([0, 1, 1, 2, 1, 1, 0, 1], [0, 0, 0, 0, 0, 1, 0, 1])
    enlarged = 0.08 * 2
    nodes = np.array([[0, 0], [1, 0], [2, 0], [1, 1]])
    moved = nodes + enlarged * np.array([[0, 0], [0, 1], [0, -0.5], [-0.25, 0.5]])
    found = {tuple(np.round([*x, *y], 2)) for x, y in (drawn(all_kinds, k) for k in range(1, 5))}
    pairs = [np.array([moved[a], moved[b]]).T.ravel() for a, b in ((0, 1), (1, 2), (1, 3), (0, 3))]
    assert found == {tuple(np.round(pair, 2)) for pair in pairs}
    caption = text(all_kinds, "#shape-caption")
    assert "the largest displacement drawn as 0.16 m" in caption
    assert "the mirror turns by 0.125 mrad and its port by −2.00 mrad" in caption
    mirror = all_kinds.evaluate("document.getElementById('shape').data.at(-1)")
    assert [mirror["x"][0], mirror["y"][0]] == pytest.approx([2.0, -0.5 * enlarged], abs=0.001)
    widths = all_kinds.evaluate("""['structure', 'shape'].map((id) => document.getElementById(id).data
        .filter((each) => each.mode === 'lines' && each.line.color.startsWith('rgb')).map(({ line }) => line.width))""")
    assert widths[0] == [2 * width for width in widths[1]]
    assert max(widths[0]) == 9


def test_bars_that_would_be_strained_too_much_are_moved_less(all_kinds: Browser):
    look_at(all_kinds, "001")
    # 0.4 of the bar of 0.1 m, instead of 0.08 of the 9 m of the whole.
    assert "the largest displacement drawn as 0.040 m" in text(all_kinds, "#shape-caption")


def test_a_spatial_truss_is_deformed_as_seen_from_the_chosen_side(all_kinds: Browser):
    look_at(all_kinds, "002")
    for index, moves in ((1, False), (2, True)):
        all_kinds.evaluate(f"document.querySelectorAll('#shape-views button')[{index}].click()")
        # A motion along z is not seen from above, and lifts the whole from aside.
        lifted = drawn(all_kinds, 1)[1].max() - drawn(all_kinds, 0)[1].max()
        assert lifted == pytest.approx(0.08 * 3.2 if moves else 0, abs=1e-9)
        pressed = (
            "[...document.querySelectorAll('.view[aria-pressed=true]')].map((each) => each.dataset.view)"
        )
        assert all_kinds.evaluate(pressed) == [str(index)] * 2, "both pictures are looked at from one side"


def test_a_beam_is_drawn_through_its_stations(all_kinds: Browser):
    look_at(all_kinds, "003")
    x, y = drawn(all_kinds, 1)
    assert x.tolist() == [0, 4, 8]
    assert y == pytest.approx([0, 0.2, 1], abs=0.005)
    at = all_kinds.evaluate("(({ x, y }) => [x[0], y[0]])(document.getElementById('shape').data.at(-1))")
    assert at == pytest.approx([6.0, 0.6], abs=0.005), "between two stations"


def test_a_chain_is_drawn_by_angles_beside_that_of_the_mirror(all_kinds: Browser):
    look_at(all_kinds, "004")
    bodies, mirror = all_kinds.evaluate("document.getElementById('shape').data.slice(2).map(({ y }) => y)")
    # All angles in the largest one, which is the mirror's.
    assert bodies == pytest.approx([-0.125, 0.25], abs=0.002)
    assert mirror == [-1]
    assert "The mirror turns by −4.00 and its port by 1.00 times" in text(all_kinds, "#shape-caption")
    assert "<b>bold</b>" in all_kinds.evaluate("document.getElementById('shape').textContent")


@pytest.mark.parametrize("case", range(len(FIRST)))
def test_the_mode_shown_first_is_one_of_the_structure_that_matters(all_kinds: Browser, case: int):
    look_at(all_kinds, f"{6 + case:03d}")
    assert chosen(all_kinds) == [FIRST[case][1]] * 2


def test_without_geometry_the_report_says_that_there_are_no_shapes(all_kinds: Browser):
    look_at(all_kinds, "005")
    assert all_kinds.evaluate("document.getElementById('shape-panel').hidden") is True
    assert "came without geometry: its mode shapes cannot be drawn" in text(all_kinds, "#modes-caption")
    assert all_kinds.evaluate("document.querySelectorAll('#modes button').length") == 0


def test_on_paper_the_shape_is_as_wide_as_the_text(all_kinds: Browser):
    look_at(all_kinds, "000")
    # A browser tells of printing while the page still is one of the screen, here a phone's.
    all_kinds.evaluate("dispatchEvent(new Event('beforeprint'))")
    wide = all_kinds.evaluate("document.getElementById('shape').getBoundingClientRect().width")
    assert wide == pytest.approx(178 / 25.4 * 96, abs=1.5)
    all_kinds.evaluate("dispatchEvent(new Event('afterprint'))")


# ---- requirement lines ----


def test_verdicts_on_a_line_are_told_in_words_and_marked_where_it_is_exceeded_most(
    browser: Browser, tmp_path: Path
):
    verdicts = (EXCEEDED, MET, dict.fromkeys(MET))
    points = [fake.point(k, 8.0) | {"requirement_line": verdict} for k, verdict in enumerate(verdicts)]
    shares = {"jitter_total": 1 - 5e-7, "jitter_hub": 1 - 2e-6}
    limits = {name: share * points[0]["metrics"][name] for name, share in shares.items()}
    opened(
        browser, run_of(*points, requirement_line=LINE, requirements=limits), tmp_path, fragment="#point=000"
    )
    assert (
        "✕ Exceeds the requirement line, most at 10.00 Hz, by 10.00 µrad: 30.00 µrad where 20.00 µrad is allowed."
        in text(browser, "#cumulative-caption")
    )
    color = "getComputedStyle(document.querySelector('#cumulative-caption .mark')).color"
    assert browser.evaluate(color) == "rgb(166, 69, 0)"
    assert "✕ exceeded" in text(browser, "#facts")
    traces = "document.getElementById('cumulative').data"
    worst = browser.evaluate(f"{traces}.find((each) => each.name === 'worst excess')")
    assert (worst["x"], worst["y"]) == ([10, 10], pytest.approx([20, 30]))
    # Other requirements are met by as much as the run says: they may be missed by as little as a constraint.
    marks = browser.evaluate(
        "[...document.querySelectorAll('#metrics .judged .mark')].map((e) => e.innerText)"
    )
    assert [mark[2:] for mark in marks] == ["met", "exceeded"]
    look_at(browser, "001")
    kept = "● Keeps below the requirement line, closest at 100.0 Hz, with 45.00 µrad of 60.00 µrad."
    assert kept in text(browser, "#cumulative-caption")
    assert "● met" in text(browser, "#facts")
    names = browser.evaluate(f"{traces}.map(({{ name }}) => name)")
    assert "required" in names and "worst excess" not in names
    look_at(browser, "002")
    assert "not judged" in text(browser, "#facts")
    assert "requirement line" not in text(browser, "#cumulative-caption")
