"""The report is one file that asks nothing of any network, shows a run, and hides its false numbers."""

from __future__ import annotations

import copy
import hashlib
import json
import math
import re
from base64 import b64encode
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
from fake_report import HOSTILE, fake_run, large_run, point, spatial_run

from fosopt.report import write_report


class Page(HTMLParser):
    """What a browser would find in a report: tags with their attributes, and the text of each script."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self._within = False
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._within = tag == "script"
        if self._within:
            self.scripts.append("")

    def handle_endtag(self, tag: str) -> None:
        self._within = False

    def handle_data(self, data: str) -> None:
        if self._within:
            self.scripts[-1] += data

    @property
    def data(self) -> dict[str, Any]:
        parsed = json.loads(self.scripts[0])
        assert isinstance(parsed, dict)
        return parsed

    @property
    def policy(self) -> str:
        (content,) = [tag[1]["content"] for tag in self.tags if "http-equiv" in tag[1]]
        assert content is not None
        return content


def written(run: dict[str, object], folder: Path) -> Page:
    path = folder / "report.html"
    write_report(run, path)
    return Page(path)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Page:
    return written(fake_run(), tmp_path_factory.mktemp("report"))


def test_the_page_has_one_data_block_the_library_and_one_script(page: Page) -> None:
    kinds = [attributes.get("type") for tag, attributes in page.tags if tag == "script"]
    assert kinds == ["application/json", None, None]
    assert "plotly.js" in page.scripts[1][:200]


def test_hostile_text_never_becomes_markup(page: Page, tmp_path: Path) -> None:
    hostile = [
        "</script><script>alert(2)</script>",
        "<!--<script>",
        "\u2028\u2029 & ]]>",
        "\ud800 ${a} $data",
    ]
    run = fake_run() | {"description": "".join(hostile), "provenance": dict.fromkeys(hostile, HOSTILE)}
    other = written(run, tmp_path)
    assert len(other.scripts) == 3
    assert [tag for tag, _ in other.tags] == [tag for tag, _ in page.tags]
    assert other.data["description"] == run["description"]
    assert page.data["name"] == HOSTILE
    assert not re.search(r"[<>&\u2028]|[^\x00-\x7f]", other.scripts[0])


def test_the_policy_allows_the_two_scripts_by_hash_and_no_request(page: Page) -> None:
    directives = dict(part.strip().split(" ", 1) for part in page.policy.split(";"))
    hashes = [b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in page.scripts[1:]]
    assert directives["script-src"].split() == [f"'sha256-{digest}'" for digest in hashes]
    assert directives["default-src"] == "'none'"
    assert set(directives["img-src"].split()) == {"data:", "blob:"}


def test_only_a_front_drawn_by_webgl_may_evaluate_code(tmp_path: Path) -> None:
    assert "unsafe-eval" not in written(large_run(10_000), tmp_path).policy
    assert "'unsafe-eval'" in written(large_run(10_001), tmp_path).policy


def test_nothing_outside_the_library_names_another_address(page: Page) -> None:
    for tag, attributes in page.tags:
        assert not {"src", "srcset", "action", "ping"} & attributes.keys(), tag
        assert (attributes.get("href") or "#").startswith("#")
    for asset in (files("fosopt.report") / "assets").iterdir():
        assert not re.search(r"https?:|@import|url\(|//\w+\.", asset.read_text(encoding="utf-8")), asset.name


def test_the_script_inserts_text_as_text_only(page: Page) -> None:
    assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|DOMParser", page.scripts[2])


def test_every_element_the_script_looks_up_exists_or_is_made_by_it(page: Page) -> None:
    made = re.findall(r'\[\s*"([\w-]+)",\s*"(?:full|half)"', page.scripts[2])
    assert len(made) == 18
    known = {attributes.get("id") for _, attributes in page.tags} | set(made)
    assert set(re.findall(r'\bat\("([\w-]+)"\)', page.scripts[2])) <= known


def test_a_stable_run_is_embedded_unchanged_but_for_its_details(tmp_path: Path) -> None:
    run = fake_run()
    run["points"] = run["points"][:10]  # type: ignore[index]
    data = written(run, tmp_path).data
    bare = [
        {name: value for name, value in each.items() if name not in ("detail", "history")}
        for each in data["points"]
    ]
    given = json.loads(json.dumps(run))
    for each in given["points"]:
        del each["detail"], each["history"]
    assert data | {"points": bare} == given | {"trusses": data["trusses"]}
    assert len(data["trusses"]) == 1


FALSE = [
    {"status": "unstable"},
    {"status": "failed"},
    {"metrics": {"spectral_abscissa": 0.1, "jitter_total": 1e-5}},
]


@pytest.mark.parametrize("change", FALSE)
def test_an_unstable_or_failed_point_brings_no_jitter_and_no_step_into_the_file(
    change: dict[str, object], tmp_path: Path
) -> None:
    false = point(0, 8.0)
    false["constraints"] = [
        {"name": "2*jitter_total", "value": 3e-5, "upper": 1e-5, "slack": -2e-5, "statement": None},
        {"name": "structural_mass", "value": 8.0, "upper": 8.0, "slack": 0.0, "statement": "1 kg is 3 µrad"},
    ]
    false |= copy.deepcopy(change)
    (shown,) = written({"points": [false]}, tmp_path).data["points"]
    gone = re.compile("jitter|step|margin")
    assert {value for name, value in shown["metrics"].items() if gone.search(name)} == {None}
    assert all(value is not None for name, value in shown["metrics"].items() if not gone.search(name))
    for name in ("jitter", "spectrum", "cumulative", "by_mode", "step"):
        assert shown["detail"][name] is None
    names, rows = shown["detail"]["modes"]["names"], shown["detail"]["modes"]["rows"]
    assert {row[names.index("jitter_share")] for row in rows} == {None}
    assert shown["bounds"] == []
    assert shown["constraints"][0]["value"] is shown["constraints"][0]["slack"] is None
    assert shown["constraints"][1]["value"] == 8.0 and shown["constraints"][1]["statement"] is None
    assert {objective for _, objective, _ in shown["history"]} == {None}
    assert shown["detail"]["bode"] and shown["detail"]["truss"]
    assert false["detail"]["jitter"]


def test_a_point_without_optional_parts_is_written(tmp_path: Path) -> None:
    assert written({"points": [{"key": "0", "status": "failed", "detail": None}]}, tmp_path).data["points"]
    assert written({}, tmp_path).data == {"points": [], "trusses": []}
    assert written(spatial_run(), tmp_path).data["name"] == "Spatial mast"


def test_a_report_that_cannot_be_made_leaves_the_old_one_and_no_rest(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("old", encoding="utf-8")
    with pytest.raises(ValueError, match="JSON compliant"):
        write_report({"points": [{"metrics": {"structural_mass": math.nan}}]}, path)
    assert path.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_report_that_cannot_take_its_place_leaves_the_old_one_and_no_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(source: Path, target: Path) -> None:
        assert source.parent == target.parent and source.stat().st_size > 1e6
        raise PermissionError

    path = tmp_path / "report.html"
    path.write_text("old", encoding="utf-8")
    monkeypatch.setattr("os.replace", refuse)
    with pytest.raises(PermissionError):
        write_report({}, path)
    assert path.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_report_replaces_an_older_one(tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text("old", encoding="utf-8")
    assert written({}, tmp_path).scripts
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.html"]
