"""The frame of ``fosopt reproduce``: what is found, what is written, and what becomes of a failure."""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import json
import os
import pickle
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor, Future
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from fake_reproduction import ALL, FAILING, FIGURE, HOSTILE, SOUND, TABLE, TABLE_WITH_FIGURE
from typer.testing import CliRunner

from fosopt.cli.commands import app
from fosopt.errors import FosoptError
from fosopt.reproduce import run
from fosopt.reproduce.catalogue import find, joined, order
from fosopt.reproduce.data import curves_csv
from fosopt.reproduce.entry import Comparison, Curve, Entry, Panel, Reproduction
from fosopt.reproduce.markdown import markdown
from fosopt.reproduce.published import PUBLISHED, Printed
from fosopt.reproduce.wording import columns, computed, error, published, sentence

VOID = {"meta", "img"}


class Page(HTMLParser):
    """Tags of a page with their attributes; every one that is opened must be closed in its turn."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.texts: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def rows(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8"))))


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """All fake entries, written once."""
    out = tmp_path_factory.mktemp("run") / "deep" / "out"
    return out, run.reproduce(list(ALL.values()), out)


@pytest.fixture(scope="module")
def page(written):
    return Page((written[0] / run.PAGE).read_text(encoding="utf-8"))


@pytest.fixture
def fakes(monkeypatch, tmp_path):
    """Put entries in the place of the catalogue, and stand in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def put(*entries: Entry):
        monkeypatch.setattr("fosopt.reproduce.catalogue.catalogue", lambda: joined(entries))

    return put


def invoke(*arguments):
    return CliRunner().invoke(app, ["reproduce", *map(str, arguments)], prog_name="fosopt")


# What is found


def test_entries_stand_in_the_order_of_their_numbers():
    names = ["figure-3.9", "figure-10.1", "table-3.10", "figure-3.10", "figure-2.30"]
    assert sorted(names, key=order) == [
        "figure-2.30",
        "figure-3.9",
        "figure-3.10",
        "table-3.10",
        "figure-10.1",
    ]
    with pytest.raises(ValueError, match=r"'table-3\.3' stands in the catalogue twice"):
        joined([TABLE, TABLE])


@pytest.mark.parametrize(
    ("names", "found"),
    [
        ([], ["table-3.3", "figure-3.20", "table-4.1"]),
        (["table-4.1", "figure-3.20", "table-4.1"], ["figure-3.20", "table-4.1"]),
        (["chapter-3"], ["table-3.3", "figure-3.20"]),
        (["tables"], ["table-3.3", "table-4.1"]),
        (["figures", "chapter-4"], ["figure-3.20", "table-4.1"]),
        (["Figure 3.20"], ["figure-3.20"]),
    ],
)
def test_entries_are_found_by_name_chapter_and_kind(names, found):
    assert [each.name for each in find(names, SOUND)] == found


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "figure-3.21",
            "'figure-3.21' is no table or figure of the dissertation; did you mean 'figure-3.20'",
        ),
        ("tabel-3.3", "did you mean 'table-3.3' or 'table-4.1'?"),
        ("xyz", "'xyz' is no table or figure of the dissertation; 'fosopt reproduce --list' names all"),
        ("figure-3.4", "figure-3.4 is a drawing, nothing is plotted in it; 'fosopt reproduce --list'"),
    ],
)
def test_an_unknown_name_is_refused_with_the_nearest_known_ones(name, message):
    with pytest.raises(FosoptError, match=re.escape(message)):
        find(["table-3.3", name], SOUND)


# Numbers as people read them


@pytest.mark.parametrize(
    ("printed", "number", "left", "right", "relative"),
    [
        (Printed("50.000"), 49.9989, "50.000", "49.999", "0.00 %"),
        (Printed("9.50"), 9.528, "9.50", "9.528", "+0.29 %"),
        (Printed("43.00"), 42.0, "43.00", "42.00", "−2.33 %"),
        (Printed("2.227e-3"), 2.2e-3, "2.227e-3", "0.002200", "−1.21 %"),
        (Printed("0.0621"), 55.0, "0.0621", "55.0000", "×885.7"),
        (63, 63, "63", "63", "0.00 %"),
        (Printed("0.00"), 0.0, "0.00", "0.00", ""),
        (None, 1.23456e-12, "–", "1.235 × 10^{−12}", ""),
        (None, -2.5e7, "–", "−2.500 × 10^{7}", ""),
        (1.5, np.float64(3.0), "1.500", "3.000", "+100.00 %"),
        (3, np.int64(3), "3", "3", "0.00 %"),
        ("stable", "unstable", "stable", "unstable", ""),
    ],
)
def test_a_computed_number_shows_the_digits_of_the_printed_one(printed, number, left, right, relative):
    row = Comparison("what", printed, number)
    assert (published(row), computed(row), error(row)) == (left, right, relative)


def test_columns_that_say_nothing_are_left_out():
    assert list(columns([Comparison("a", "yes", "no")])) == ["Quantity or statement", "Published", "Computed"]
    assert "Unit" in columns([Comparison("a", 1, 2, "Hz"), Comparison("b", 1, 2)])


def test_counts_are_a_sentence():
    found = {"matches": 1, "differs": 2, "not determinable": 1, "failed": 0}
    assert sentence(found) == "1 matches, 2 differ, 1 is not determinable"
    assert sentence({}) == "nothing was computed"


def test_a_number_that_is_none_is_refused():
    with pytest.raises(ValueError, match="'jitter': computed is nan"):
        Comparison("jitter", 1.0, float("nan"))


def test_printed_numbers_are_numbers_with_their_digits():
    fem1 = PUBLISHED["table_2_2"]["fem1"]
    assert fem1[1] == 9.5
    assert fem1[1].text == "9.50"
    copy = pickle.loads(pickle.dumps(fem1[1]))
    assert (copy, copy.text) == (9.5, "9.50")


# What is written


def test_everything_is_written_and_a_failure_stops_nothing(written):
    out, outcomes = written
    assert sorted(path.name for path in out.iterdir()) == [
        "comparisons.csv",
        "figure-3.20.csv",
        "figure-3.20.png",
        "figure-3.20.svg",
        "index.html",
        "reproduction.json",
        "table-3.3.csv",
        "table-4.1-curves.csv",
        "table-4.1.csv",
        "table-4.1.png",
        "table-4.1.svg",
    ]
    assert [each.entry.name for each in outcomes] == list(ALL)
    assert outcomes[0].error == f"ValueError: no such mode {HOSTILE}"
    assert outcomes[1].error.startswith("drawing it: ValueError: ")
    assert [each.result is None for each in outcomes] == [True, True, False, False, False]


def test_curves_are_data_with_units_in_the_header(written):
    found = rows(written[0] / "figure-3.20.csv")
    assert list(found[0]) == ["panel", "curve", "frequency [Hz]", "gain [dB]"]
    assert len(found) == 2 * 3 * 3
    assert [found[k]["curve"] for k in (0, 3, 6)] == ["plant, θ_m", "loop", "loop 2"]
    assert [each["gain [dB]"] for each in found[6:9]] == ["3", "", "9"]
    assert {each["panel"] for each in found} == {"1", "2"}


def test_quantities_of_different_panels_have_columns_of_their_own():
    x = np.array([0.1 + 0.2])
    panels = [
        Panel("t [s]", "y [m]", (Curve(x, 2 * x),), "first"),
        Panel("t [s]", "v [m/s]", (Curve(x, 3 * x), Curve(x, x))),
        Panel("v [m/s]", "v [m/s]", (Curve(x, 4 * x),)),
    ]
    assert curves_csv(panels).splitlines() == [
        "panel,curve,t [s],y [m],v [m/s],v [m/s] (ordinate)",
        "1: first,1,0.3,0.6,,",
        "2,1,0.3,,0.9,",
        "2,2,0.3,,0.3,",
        "3,1,,,0.3,1.2",
    ]


def test_comparisons_are_data(written):
    out, _ = written
    assert rows(out / "table-4.1.csv")[0] == {
        "what": "force, J_m = 2 %",
        "published": "0.0621",
        "computed": "5.5",
        "unit": "µdu",
        "relative error": f"{5.5 / 0.0621 - 1:.12g}",
        "note": "see | the *figure*",
    }
    found = rows(out / "comparisons.csv")
    assert [each["entry"] for each in found] == ["table-3.3", *["figure-3.20"] * 3, *["table-4.1"] * 2]
    assert found[1]["published"] == "230.00"
    assert found[-1]["verdict"] == "differs"


def test_the_record_holds_what_was_compared(written):
    out, _ = written
    record = json.loads((out / "reproduction.json").read_text(encoding="utf-8"))
    assert record["complete"] is True
    assert record["counts"] == {"matches": 1, "differs": 1, "not determinable": 1, "failed": 2}
    failed, _, table, figure, _ = record["entries"]
    assert (failed["verdict"], failed["error"]) == ("failed", f"ValueError: no such mode {HOSTILE}")
    assert figure["files"] == ["figure-3.20.png", "figure-3.20.svg", "figure-3.20.csv"]
    assert table["comparisons"][0] | {"note": ""} == {
        "what": "rows",
        "published": None,
        "computed": 3,
        "unit": "",
        "relative_error": None,
        "note": "",
    }
    assert figure["comparisons"][0]["relative_error"] == pytest.approx(230.004 / 230 - 1)


def test_the_page_is_inert(written, page):
    text = (written[0] / run.PAGE).read_text(encoding="utf-8")
    assert page.all("script") == []
    assert HOSTILE not in text
    assert "".join(page.texts).count(HOSTILE) == 5
    policy = next(each["content"] for each in page.all("meta") if each.get("http-equiv"))
    style = re.search(r"<style>(.*?)</style>", text, re.DOTALL)[1]
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()
    assert policy == (
        f"default-src 'none'; style-src 'sha256-{digest}'; img-src data:; base-uri 'none'; form-action 'none'"
    )
    assert not any(
        name == "style" or name.startswith("on") for _, attributes in page.tags for name in attributes
    )
    assert not re.search(r"url\(|@import", style)


def test_the_page_shows_every_entry_and_links_to_it(written, page):
    ids = [each["id"] for each in page.all("article")]
    assert ids == list(ALL)
    links = {each["href"] for each in page.all("a")}
    assert {f"#{name}" for name in ALL} <= links
    known = {each.get("id") for _, each in page.tags}
    for link in links:
        assert link[1:] in known if link.startswith("#") else (written[0] / link).is_file()
    assert "Of 5 tables and figures, 1 matches, 1 differs, 1 is not determinable, 2 failed." in page.texts


def test_images_stand_in_the_page_and_are_described(written, page):
    images = page.all("img")
    assert [each["width"] for each in images] == ["490", "1008"]
    kind, data = images[0]["src"].split(",")
    assert kind == "data:image/svg+xml;base64"
    assert base64.b64decode(data) == (written[0] / "figure-3.20.svg").read_bytes()
    assert images[0]["alt"].startswith("Figure 3.20: gain [dB] against frequency [Hz] of plant, θ_m, loop;")
    assert {each["loading"] for each in images} == {"lazy"}


def test_a_heavy_drawing_is_shown_as_pixels(tmp_path, monkeypatch):
    monkeypatch.setattr("fosopt.reproduce.page._HEAVY", 10)
    run.reproduce([FIGURE], tmp_path)
    source = Page((tmp_path / run.PAGE).read_text(encoding="utf-8")).all("img")[0]["src"]
    assert base64.b64decode(source.removeprefix("data:image/png;base64,")).startswith(b"\x89PNG")


def test_only_the_formats_asked_for_are_files(tmp_path):
    (outcome,) = run.reproduce([FIGURE], tmp_path, formats=("svg",))
    assert outcome.files == ("figure-3.20.svg", "figure-3.20.csv")


def test_a_second_process_draws_the_same(tmp_path):
    for name in ("here", "there"):
        run.reproduce(list(SOUND.values()), tmp_path / name, parallel=name == "there")
    files = [
        sorted(path.relative_to(tmp_path / name) for path in (tmp_path / name).iterdir())
        for name in ("here", "there")
    ]
    assert files[0] == files[1]
    for name in files[0]:
        assert (tmp_path / "here" / name).read_bytes() == (tmp_path / "there" / name).read_bytes()


def test_a_drawing_process_that_is_killed_is_replaced(tmp_path, monkeypatch):
    class Dying:
        """Takes one drawing, and dies."""

        def __init__(self, *_, **__):
            self.taken = 0

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def submit(self, *_):
            self.taken += 1
            if self.taken > 1:
                raise BrokenExecutor("dead")
            future = Future()
            future.set_exception(BrokenExecutor("dying"))
            return future

    monkeypatch.setattr("fosopt.reproduce.studio.ProcessPoolExecutor", Dying)
    outcomes = run.reproduce([FIGURE, TABLE_WITH_FIGURE], tmp_path, parallel=True)
    assert [each.error for each in outcomes] == ["", ""]
    assert (tmp_path / "figure-3.20.png").stat().st_size > 1000
    assert (tmp_path / "table-4.1.png").stat().st_size > 1000


def test_an_interruption_keeps_what_is_finished(tmp_path):
    def interrupted() -> Reproduction:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run.reproduce([FIGURE, Entry("figure-3.21", "x", interrupted), TABLE_WITH_FIGURE], tmp_path)
    record = json.loads((tmp_path / "reproduction.json").read_text(encoding="utf-8"))
    assert [each["name"] for each in record["entries"]] == ["figure-3.20"]
    assert record["complete"] is False
    assert "Interrupted: 1 of 3 are shown." in (tmp_path / "index.html").read_text(encoding="utf-8")


def test_the_markdown_page_compares_every_entry():
    text = markdown(list(run.computed(list(ALL.values()))))
    assert "Of 5 tables and figures, 2 match, 1 differs, 1 is not determinable, 1 failed." in text
    assert "| [3](#chapter-3) | 1 | 0 | 1 | 0 |" in text
    assert "| [Table 4.1](#table-4.1) | A table | differs |" in text
    assert (
        '<a id="table-4.1"></a>\n\n### Table 4.1: A table\n\nJitter.\n\nVerdict: **differs**. Because of x<sub>0</sub>'
        in text
    )
    assert (
        "| force, J<sub>m</sub> = 2 % | 0.0621 | 5.5000 | µdu | ×88.57 | see \\| the \\*figure\\* |" in text
    )
    assert "Verdict: **failed**. ValueError: no such mode &lt;script&gt;" in text
    assert "Drawings, with nothing plotted: figures 4.10 (" in text
    assert HOSTILE not in text


# The command


def test_the_command_writes_to_its_folder_and_says_what_it_found(fakes):
    fakes(*SOUND.values())
    result = invoke()
    assert result.exit_code == 0
    assert Path("runs/reproduction/index.html").is_file()
    lines = result.stdout.splitlines()
    assert lines[0] == "table-3.3 not determinable: Nothing is printed."
    assert ["crossover", "230.00", "230.00", "Hz", "0.00", "%"] in [line.split() for line in lines]
    assert lines[-2] == "1 matches, 1 differs, 1 is not determinable"
    assert re.fullmatch(r"computed in \d+ s; open runs/reproduction/index.html in a browser", lines[-1])
    assert [line.rsplit(" (")[0] for line in result.stderr.splitlines()] == [
        "[1/3] table-3.3: not determinable",
        "[2/3] figure-3.20: matches",
        "[3/3] table-4.1: differs",
    ]


def test_a_failed_entry_is_code_4(fakes):
    fakes(FAILING, TABLE)
    result = invoke("--out", "there", "--json")
    assert result.exit_code == 4
    assert json.loads(result.stdout)["counts"]["failed"] == 1
    assert f"figure-2.12 failed: ValueError: no such mode {HOSTILE}" in result.stderr
    assert Path("there/table-3.3.csv").is_file()


def test_an_unknown_name_is_code_3_and_one_line(fakes):
    fakes(*SOUND.values())
    result = invoke("figure-3.21")
    assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (3, "", 1)
    assert "did you mean 'figure-3.20'" in result.stderr
    assert not Path("runs").exists()


def test_a_folder_that_cannot_be_written_is_code_3_before_anything_is_computed(fakes):
    calls = []

    def counted() -> Reproduction:
        calls.append(1)
        return FIGURE.compute()

    fakes(Entry("figure-3.20", "x", counted))
    Path("file").touch()
    Path("taken/index.html").mkdir(parents=True)
    for target in ("file", "file/below"):
        result = invoke("--out", target)
        assert (result.exit_code, result.stderr.count("\n")) == (3, 1)
        assert result.stderr.startswith(f"fosopt: {target}: ")
    for options, culprit in ((("--out", "taken"), "index.html"), (("--page", "nowhere/page.md"), "nowhere")):
        result = invoke(*options)
        assert (result.exit_code, result.stderr.count("\n")) == (3, 1)
        assert culprit in result.stderr
    assert calls == []


def test_the_page_option_draws_nothing(fakes):
    fakes(*SOUND.values())
    Path("page.md").write_text("old", encoding="utf-8")
    result = invoke("--page", "page.md")
    assert result.exit_code == 0
    assert result.stdout.endswith("wrote page.md\n")
    assert Path("page.md").read_text(encoding="utf-8") == markdown(list(run.computed(list(SOUND.values()))))
    assert sorted(path.name for path in Path().iterdir()) == ["page.md"]


def test_names_are_listed(fakes):
    fakes(*SOUND.values())
    assert invoke("--list").stdout.splitlines()[0] == "table-3.3    Another table"
    listed = json.loads(invoke("--list", "--json", "tables").stdout)
    assert listed == [
        {"name": "table-3.3", "title": "Another table"},
        {"name": "table-4.1", "title": "A table"},
    ]


def test_ctrl_c_ends_after_the_entry_at_hand(fakes):
    def interrupting() -> Reproduction:
        os.kill(os.getpid(), signal.SIGINT)
        return TABLE.compute()

    fakes(Entry("figure-3.1", "x", interrupting), FIGURE)
    result = invoke("--out", "there", "--json")
    assert result.exit_code == 130
    record = json.loads(result.stdout)
    assert [each["name"] for each in record["entries"]] == ["figure-3.1"]
    assert "Interrupted: 1 of 2 are shown." in Path("there/index.html").read_text(encoding="utf-8")
    Path("page.md").write_text("old", encoding="utf-8")
    result = invoke("--page", "page.md")
    assert result.exit_code == 130
    assert result.stdout.endswith("left page.md as it was\n")
    assert sorted(path.name for path in Path().iterdir()) == ["page.md", "there"]
    assert Path("page.md").read_text(encoding="utf-8") == "old"


SLOW = """
import sys, time
sys.path[:0] = sys.argv[1:3]
from fake_reproduction import FIGURE
from fosopt.cli.commands import app
from fosopt.reproduce import catalogue
from fosopt.reproduce.entry import Entry

def slow():
    time.sleep(0.2)
    return FIGURE.compute()

entries = [Entry(f"figure-3.{k}", "slow", slow) for k in range(1, 100)]
catalogue.catalogue = lambda: catalogue.joined(entries)
app(["reproduce", "--out", sys.argv[3]], prog_name="fosopt")
"""


@pytest.fixture
def drawing(tmp_path):
    """A reproduction in a session of its own, of which something is drawn already."""
    here = Path(__file__).parent
    process = subprocess.Popen(
        [sys.executable, "-c", SLOW, here, here.parent, tmp_path / "out"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stderr.readline().startswith("[1/99] figure-3.1: matches")
    yield process
    process.kill()
    process.wait()
    process.stdout.close()
    process.stderr.close()


def test_ctrl_c_at_a_terminal_reaches_the_drawing_processes_and_leaves_them_alone(drawing, tmp_path):
    os.killpg(drawing.pid, signal.SIGINT)
    stdout, stderr = drawing.communicate(timeout=60)
    assert drawing.returncode == 130
    assert "Traceback" not in stderr
    assert stdout.endswith("in a browser\n")
    assert "failed" not in stdout
    assert "Interrupted" in (tmp_path / "out" / "index.html").read_text(encoding="utf-8")


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="only Linux lists the children of a process")
def test_drawing_processes_end_with_the_one_that_started_them(drawing):
    children = Path(f"/proc/{drawing.pid}/task/{drawing.pid}/children").read_text(encoding="utf-8").split()
    assert children
    drawing.kill()
    deadline = time.monotonic() + 30
    while any(Path("/proc", child).exists() for child in children):
        assert time.monotonic() < deadline
        time.sleep(0.05)
