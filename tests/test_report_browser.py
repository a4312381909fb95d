"""Reports in a headless Chromium without a network: they load, follow mouse and keys, print, and obey no text."""

from __future__ import annotations

import json
import re
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import fake_report as fake
import numpy as np
import pytest
from headless import DESKTOP, PHONE, Browser

from fosopt.report import write_report

ATTACK = "\"><img src=x onerror=alert(1)><svg onload=alert(2)>'=cmd|' /C calc'!A1 </script><b>bold</b> {{7*7}} ${1}"


def selected(key: str) -> str:
    return f"document.querySelector('#announcement').textContent.startsWith('Point {key} selected')"


# What the figures below the front show, in one comparable text.
FIGURES = (
    "structure",
    "history",
    "jitter",
    "by-mode",
    "cumulative",
    "mode-curves",
    "spectrum",
    "bode",
    "sensitivity",
    "step",
    "window",
    "poles",
    "shape",
)
LINKED = f"""JSON.stringify({json.dumps(FIGURES)}.map(
    (id) => document.getElementById(id).data.map(({{ x, y, text }}) =>
        [[...x].slice(0, 40), [...y].slice(0, 40), text]
    )
))"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("reports")


def written(run: dict[str, Any], folder: Path, name: str) -> Path:
    path = folder / f"{name}.html"
    write_report(run, path)
    return path


@pytest.fixture(scope="module")
def front(folder: Path) -> Path:
    return written(fake.fake_run(), folder, "front")


def text(browser: Browser, selector: str) -> str:
    return browser.evaluate(f"document.querySelector({json.dumps(selector)}).innerText")


def look_at(browser: Browser, path: Path, key: str) -> None:
    """Show a point of a report on a desktop, loading the report where another page is open."""
    width = browser.evaluate("innerWidth")
    if width == DESKTOP and browser.evaluate("location.pathname") == path.resolve().as_uri().removeprefix(
        "file://"
    ):
        browser.evaluate(f"location.hash = '#point={key}'")
    else:
        browser.open(path, fragment=f"#point={key}")
    browser.wait(selected(key))


def place_of(browser: Browser, key: str) -> list[float]:
    """Where in the window the front shows a point."""
    return browser.evaluate(f"""(() => {{
        const gd = document.getElementById('front'), box = gd.getBoundingClientRect();
        const trace = gd.data.findIndex((one) => one.customdata?.includes('{key}'));
        const at = gd.data[trace].customdata.indexOf('{key}'), {{ xaxis, yaxis }} = gd._fullLayout;
        return [box.left + xaxis._offset + xaxis.d2p(gd.data[trace].x[at]),
                box.top + yaxis._offset + yaxis.d2p(gd.data[trace].y[at])];
    }})()""")


class Counting(BaseHTTPRequestHandler):
    """Counts who comes by."""

    visits = 0

    def do_GET(self) -> None:
        Counting.visits += 1
        self.send_error(404)

    def log_message(self, *_: Any) -> None:
        pass


def test_the_browser_has_no_network_and_notices_what_a_page_wants_of_it(chromium: Browser, folder: Path):
    with ThreadingHTTPServer(("127.0.0.1", 0), Counting) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/"
        path = folder / "bad.html"
        path.write_text(f"<img src='{address}'><script>console.error('bad'); nothing()</script>")
        chromium.visit(path)
        chromium.wait("document.querySelector('img')?.complete")
        server.shutdown()
    assert Counting.visits == 0
    assert chromium.foreign == [address]
    assert any("bad" in each for each in chromium.troubles)
    assert any("nothing is not defined" in each for each in chromium.troubles)


@pytest.mark.parametrize("width", [DESKTOP, PHONE])
def test_a_front_loads_without_a_network_and_fits_the_window(browser: Browser, front: Path, width: int):
    browser.open(front, width)
    assert browser.evaluate("document.querySelector('h1').textContent") == fake.HOSTILE
    assert browser.evaluate("document.title").startswith(fake.HOSTILE)
    drawn = browser.evaluate(
        f"{json.dumps(FIGURES)}.filter((id) => !document.querySelector(`#${{id}} .main-svg`))"
    )
    assert not drawn, f"{drawn} are not drawn"
    assert len(browser.requests) <= 2, "the file, and nothing after it"


def test_a_click_on_a_point_changes_every_figure(browser: Browser, front: Path):
    look_at(browser, front, "003")
    before = json.loads(browser.evaluate(LINKED))
    browser.click(*place_of(browser, "005"))
    browser.wait(selected("005"))
    after = json.loads(browser.evaluate(LINKED))
    same = [name for name, a, b in zip(FIGURES, before, after, strict=True) if a == b]
    # Of the fake run the error in the window is the same for all points, and so is every mode but for its bars.
    assert set(same) <= {"window", "shape"}, f"{same} do not follow the selection"
    assert browser.evaluate("location.hash") == "#point=005"
    assert text(browser, "#selected-title").startswith("Point 005")
    browser.evaluate("location.hash = '#point=003'")
    browser.wait(selected("003"))
    assert json.loads(browser.evaluate(LINKED)) == before


def test_a_report_is_used_by_keyboard(browser: Browser, front: Path):
    look_at(browser, front, "003")
    before = browser.evaluate(LINKED)
    browser.evaluate("document.getElementById('front').focus()")
    assert browser.evaluate("document.activeElement.getAttribute('aria-label')")
    browser.press("ArrowRight")
    browser.wait(selected("004"))
    assert browser.evaluate(LINKED) != before
    browser.press("ArrowUp")
    browser.wait(selected("003"))
    browser.press("End")
    browser.wait(selected("103"))
    browser.press("Home")
    browser.wait(selected("000"))
    browser.press("Enter")
    assert browser.evaluate("document.activeElement.id") == "selected"
    browser.evaluate("document.querySelector('#points tr[data-key=\"005\"] button').focus()")
    browser.press("Enter")
    browser.wait(selected("005"))
    browser.press("ArrowDown")
    browser.wait(selected("006"))
    assert browser.evaluate("document.activeElement.dataset.key") == "006"
    assert browser.evaluate("document.activeElement.getAttribute('aria-pressed')") == "true"
    browser.press("Tab")
    ring = "(({ outlineStyle, outlineWidth }) => outlineStyle + outlineWidth)(getComputedStyle(document.activeElement))"
    assert browser.evaluate(ring) == "solid2px"


def test_what_is_drawn_is_what_was_computed(browser: Browser, front: Path):
    look_at(browser, front, "004")
    given = fake.fake_run()["points"][4]["detail"]  # type: ignore[index]
    for name, trace, key, factor in (
        ("bode", 1, "loop_phase_deg", 1.0),
        ("cumulative", 3, "total", 1e6),
        ("step", 0, "response", 1e6),
    ):
        shown = browser.evaluate(f"[...document.getElementById('{name}').data[{trace}].y]")
        expected = [factor * value for value in given[name][key]]
        span = max(expected) - min(expected)
        assert shown == pytest.approx(expected, abs=2e-5 * span, rel=1e-3)
    frequency = browser.evaluate("[...document.getElementById('bode').data[0].x]")
    assert frequency == pytest.approx(given["bode"]["frequency_hz"], rel=2e-6)


def test_what_is_proven_is_shown_as_a_region_of_the_front(browser: Browser, front: Path):
    look_at(browser, front, "003")
    shapes = browser.evaluate(
        "document.getElementById('front').layout.shapes.filter((each) => each.type === 'rect')"
    )
    assert [shape["x1"] for shape in shapes] == [5.1]
    low, high = browser.evaluate("document.getElementById('front')._fullLayout.xaxis.range")
    assert low < 5.1 < high
    assert shapes[0]["x0"] < low, "the region reaches the edge of the picture"
    share = (5.1 - low) / (high - low)
    assert 0.03 < share < 0.1, "the region is to be seen and not to push the points together"
    assert "proven empty" in text(browser, "#front-caption")
    names = browser.evaluate("document.getElementById('front').data.map(({ name }) => name)")
    assert "no linear controller on the same structure below" in names


def test_an_active_constraint_has_its_price_in_words(browser: Browser, front: Path):
    look_at(browser, front, "004")
    rows = browser.evaluate(
        "[...document.querySelectorAll('#constraints tbody tr')].map((row) => row.innerText)"
    )
    (active,) = [row for row in rows if "active" in row and "inactive" not in row]
    # 6.1e-6 rad/kg at 10.16 kg, of which a fiftieth is rounded down to 0.2 kg.
    assert "0.2 kg more costs 1.2 µrad of total jitter" in active.replace("\u00a0", " ")
    assert "6.10 µrad/kg" in active.replace("\u00a0", " ")


def test_requirements_cross_the_jitter_budget(browser: Browser, front: Path):
    look_at(browser, front, "004")
    places = browser.evaluate("document.getElementById('jitter').layout.shapes.map(({ x0 }) => x0)")
    assert sorted(places) == pytest.approx([40.0, 75.0])
    (line,) = browser.evaluate("document.getElementById('cumulative').layout.shapes.map(({ y0 }) => y0)")
    assert line == pytest.approx(75.0)


def test_a_co_design_gain_is_drawn_and_stated(browser: Browser, front: Path):
    look_at(browser, front, "003")
    assert browser.evaluate("[...document.getElementById('gain').data[0].y]") == pytest.approx(
        [100 * (113 - 90) / 113, 100 * (90 - 70) / 90]
    )
    assert "gains 20.4 to 22.2 % over sequential" in text(browser, "#comparison-text")


def test_an_unstable_point_shows_its_reason_and_no_jitter(browser: Browser, front: Path):
    look_at(browser, front, "011")
    assert "18.2 Hz" in text(browser, "#reason")
    rows = browser.evaluate("[...document.querySelectorAll('#metrics tr')].map((row) => row.innerText)")
    jitter = [row for row in rows if "jitter" in row.lower()]
    assert jitter and all("–" in row for row in jitter)
    gone = ["jitter", "by-mode", "cumulative", "mode-curves", "spectrum", "step", "window", "account"]
    hidden = f"{json.dumps(gone)}.filter((id) => !document.getElementById(id + '-panel').hidden)"
    assert browser.evaluate(hidden) == []
    assert browser.evaluate("document.getElementById('bode-panel').hidden") is False


def test_nested_provenance_is_text(browser: Browser, front: Path):
    look_at(browser, front, "003")
    shown = text(browser, "#provenance-list")
    assert "tolerance 1e-8, threads 1, 2" in shown
    assert "yes" in shown
    assert "[object" not in shown


def test_hostile_text_stays_text_wherever_it_stands(browser: Browser, folder: Path):
    run = fake.fake_run()
    run |= {"name": ATTACK, "description": ATTACK, "provenance": {ATTACK: {ATTACK: [ATTACK]}}}
    run["quantities"]["structural_mass"]["label"] = ATTACK  # type: ignore[index]
    for point in run["points"]:  # type: ignore[attr-defined]
        point |= {"label": ATTACK, "reason": ATTACK, "strategy": ATTACK if point["strategy"] else None}
        detail = point["detail"]
        detail["truss"] |= {"kinds": [ATTACK] * 60, "names": [ATTACK] * 60}
        detail["places"] = [{"kind": "mirror", "port": ATTACK, "at": ATTACK, "xyz": [7.0, 0.0]}]
        for table in ("cumulative", "spectrum"):
            detail[table][ATTACK] = detail[table].pop("hub")
        detail["jitter"][ATTACK] = detail["jitter"].pop("hub")
        for constraint in point["constraints"]:
            constraint |= {"name": ATTACK, "statement": ATTACK}
        for bound in point["bounds"]:
            bound |= {"of": ATTACK, "assumptions": [ATTACK], "remark": ATTACK}
    path = written(run, folder, "hostile")
    browser.open(path)
    assert browser.evaluate("document.querySelector('h1').textContent") == ATTACK
    assert text(browser, "#description") == ATTACK
    browser.evaluate("document.getElementById('next').click()")
    browser.wait("!document.querySelector('#announcement').textContent.startsWith('Point 003')")
    made = "document.querySelectorAll('img, iframe, object, embed, a[href^=javascript], [onload], b').length"
    assert browser.evaluate(made) == 0
    assert browser.evaluate("document.scripts.length") == 3
    # plotly would read the tags of a name in a figure as its own.
    for figure in ("front", "jitter", "cumulative"):
        assert "<b>bold</b>" in browser.evaluate(f"document.getElementById('{figure}').textContent")


def test_on_paper_nothing_is_scrolled_away_or_cut_off(browser: Browser, front: Path):
    look_at(browser, front, "004")
    browser("Emulation.setEmulatedMedia", media="print")
    browser.evaluate("dispatchEvent(new Event('beforeprint'))")
    browser.wait("document.documentElement.classList.contains('printing')")
    text_width = 178 / 25.4 * 96  # the page's own, mm to px
    wide = browser.evaluate(f"""[...document.querySelectorAll('.plot, table')].filter(
        (each) => each.getBoundingClientRect().right > {text_width + 1}).map((each) => each.id || each.className)""")
    assert wide == []
    cut = browser.evaluate("""[...document.querySelectorAll('.scroll')].filter(
        (each) => getComputedStyle(each).maxHeight !== 'none').map((each) => each.id)""")
    assert cut == []
    assert browser.evaluate("getComputedStyle(document.getElementById('bar')).display") == "none"
    assert (
        browser.evaluate("[...document.querySelectorAll('#account details')].every((each) => each.open)")
        is True
    )
    browser.evaluate("dispatchEvent(new Event('afterprint'))")
    browser("Emulation.setEmulatedMedia", media="")
    assert (
        browser.evaluate("[...document.querySelectorAll('#account details')].some((each) => each.open)")
        is False
    )
    pages = re.findall(rb"/Type\s*/Page\b", browser.printed())
    assert 4 <= len(pages) <= 14


def structure_run(detail: dict[str, Any]) -> dict[str, Any]:
    return {
        "name": "Structure",
        "kind": "analysis",
        "objectives": [],
        "points": [fake.point(0, 8.0) | {"detail": detail}],
    }


def test_a_beam_is_drawn_with_what_stands_on_it(browser: Browser, folder: Path):
    beam = {"kind": "beam", "length": 7.0, "held": True, "stations": {"hub": 0.0, "tip": 7.0, "middle": 3.5}}
    places = [
        {"kind": kind, "port": port, "at": port, "xyz": [x, 0.0]}
        for kind, port, x in (("hub", "hub", 0.0), ("mirror", "tip", 7.0))
    ]
    path = written(structure_run({"truss": None, "structure": beam, "places": places}), folder, "beam")
    browser.open(path)
    shown = browser.evaluate("document.getElementById('structure').textContent")
    assert all(word in shown for word in ("hub", "mirror", "middle"))
    assert "Uniform beam of 7.000 m, its root fixed" in text(browser, "#structure-caption")


def test_a_chain_is_drawn_with_discs_to_scale(browser: Browser, folder: Path):
    chain = {
        "kind": "chain",
        "bodies": ["aft", "bench"],
        "inertias": [4.0, 1.0],
        "springs": [43426.0],
        "held": False,
    }
    places = [{"kind": "mirror", "port": "tip", "at": "bench", "xyz": [0.0, 0.0]}]
    path = written(structure_run({"truss": None, "structure": chain, "places": places}), folder, "chain")
    browser.open(path, PHONE)
    sizes = browser.evaluate("document.getElementById('structure').data[0].marker.size")
    assert (sizes[0] / sizes[1]) ** 2 == pytest.approx(4.0)
    shown = browser.evaluate("document.getElementById('structure').textContent")
    assert all(word in shown for word in ("aft", "bench (mirror)", "N m/rad"))


def test_bars_are_as_wide_as_their_areas_are_large(browser: Browser, folder: Path):
    nodes = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 1.0]]
    truss = {"nodes": nodes, "bars": [[0, 1], [1, 2], [2, 3]], "areas": [4e-5, 2e-5, 1e-5]}
    path = written(structure_run({"truss": truss}), folder, "bars")
    browser.open(path)
    widths = browser.evaluate("""document.getElementById('structure').data
        .filter((each) => each.mode === 'lines' && each.x.length).map(({ line }) => line.width)""")
    # Two dozen widths stand for all; the least of a third of the range is one of them.
    assert sorted(widths) == pytest.approx([2.25, 4.5, 9.0], rel=0.05)


def test_a_spatial_truss_is_looked_at_from_four_sides(browser: Browser, folder: Path):
    path = written(fake.spatial_run(), folder, "spatial")
    browser.open(path, PHONE)
    assert browser.evaluate("document.getElementById('structure-views').hidden") is False
    data = "JSON.stringify(document.getElementById('structure').data[0].x.slice(0, 12))"
    aside = browser.evaluate(data)
    # A parallel projection onto two directions of length one, at right angles to each other.
    x, y = browser.evaluate("(({ x, y }) => [[...x], [...y]])(document.getElementById('structure').data[0])")
    first, second, third, along = (np.array([x[k], y[k]]) for k in (0, 1, 4, 9))
    by_y = (second - first) / 0.354
    directions = np.column_stack([(along - first) / 0.4, by_y, (third - first - 0.177 * by_y) / 0.307])
    assert directions @ directions.T == pytest.approx(np.eye(2), abs=1e-12)
    assert directions[0, 0] > 0.9, "the mast lies along the picture"
    browser.evaluate("document.querySelectorAll('#structure-views button')[3].click()")
    browser.wait(f"{data} !== {json.dumps(aside)}")
    # Onto the y–z plane the section stands on itself: three corners, however many stations.
    pairs = browser.evaluate("""(() => { const { x, y } = document.getElementById('structure').data[0];
        return [...new Set(x.map((each, k) => each === null ? '' : `${each} ${y[k]}`))].filter(Boolean).length; })()""")
    assert pairs == 3
    assert "onto the y–z plane" in text(browser, "#structure-caption")
    assert browser.evaluate("document.querySelectorAll('#structure-views [aria-pressed=true]').length") == 1


def test_a_front_of_ten_thousand_points_and_more_is_drawn(browser: Browser, folder: Path):
    browser.open(written(fake.large_run(10_001), folder, "large"))
    assert browser.evaluate("document.getElementById('front').data[0].type") == "scattergl"


def test_cases_and_a_run_without_points_are_shown(browser: Browser, folder: Path):
    browser.open(written(fake.single_run(), folder, "cases"), PHONE)
    assert "<b>free</b>" in browser.evaluate("document.getElementById('front').textContent")
    browser.visit(written({}, folder, "empty"))
    browser.wait("document.getElementById('summary')?.textContent.includes('no points')")
