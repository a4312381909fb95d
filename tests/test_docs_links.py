"""Links of the documentation lead to files, headings and programs that exist; nothing is asked of a network."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "benchmarks").glob("*.md")])
INDEX = ROOT / "docs" / "README.md"
LINK = re.compile(r"\[[^\[\]]*\]\(([^()\s]+(?:\([^()\s]*\)[^()\s]*)*)\)")
FILE = re.compile(r"\b((?:docs|studies|notebooks|benchmarks|fosopt|tests|verify)/[\w./-]+\.\w+)")
EXTERNAL = re.compile(r"[a-z]+:")


def prose(text: str) -> str:
    """Text without its code."""
    fenced = re.sub(r"^(```|~~~).*?^\1", "", text, flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"`[^`\n]*`", "", fenced)


def anchors(text: str) -> set[str]:
    """What the headings of a page are linked by, as GitHub makes it of them."""
    found: dict[str, int] = {}
    for title in re.findall(r"^#+ +(.+)$", re.sub(r"^```.*?^```", "", text, flags=re.M | re.S), flags=re.M):
        plain = re.sub(r"<[^>]+>", "", title).strip().lower()
        name = re.sub(r"[^\w\- ]", "", plain).replace(" ", "-")
        found[name] = found.get(name, -1) + 1
        if found[name]:
            found[f"{name}-{found[name]}"] = 0
    return {*found, *re.findall(r'\b(?:id|name)="([^"]+)"', text)}


def broken(page: Path) -> Iterator[str]:
    """Relative links of a page that lead nowhere."""
    for target in LINK.findall(prose(page.read_text(encoding="utf-8"))):
        if EXTERNAL.match(target):
            continue
        name, _, anchor = target.partition("#")
        file = page.parent / name if name else page
        if not file.is_file():
            yield f"{target}: no such file"
        elif anchor and anchor not in anchors(file.read_text(encoding="utf-8")):
            yield f"{target}: no such heading"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page: Path) -> None:
    assert list(broken(page)) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_files_that_are_named_exist(page: Path) -> None:
    named = set(FILE.findall(page.read_text(encoding="utf-8")))
    assert sorted(name for name in named if not (ROOT / name).exists()) == []


def test_a_broken_link_is_noticed(tmp_path: Path) -> None:
    other = tmp_path / "other.md"
    other.write_text(
        "# A title: `code` and_more\n\n## Twice\n\n## Twice\n\n```\n# no heading\n```\n", encoding="utf-8"
    )
    page = tmp_path / "page.md"
    good = "[a](other.md#a-title-code-and_more) [b](other.md#twice-1) [c](https://example.org/x) `[d](nowhere.md)`"
    bad = "[e](missing.md) ![f](missing.png) [g](other.md#no-heading) [h](other.md#twice-2) [i](#here)"
    page.write_text(f"{good}\n\n```\n[j](nowhere.md)\n```\n\n{bad}\n", encoding="utf-8")
    assert [each.split(":")[0] for each in broken(page)] == [
        "missing.md",
        "missing.png",
        "other.md#no-heading",
        "other.md#twice-2",
        "#here",
    ]


def test_the_index_lists_every_page_and_notebook():
    text = INDEX.read_text(encoding="utf-8")
    for page in (ROOT / "docs").glob("*.md"):
        assert page == INDEX or f"]({page.name})" in text, page.name
    for notebook in (ROOT / "notebooks").glob("*.py"):
        assert f"](../notebooks/{notebook.name})" in text, notebook.name
    for study in (ROOT / "studies").glob("*.yaml"):
        assert f"](../studies/{study.name})" in text, study.name
