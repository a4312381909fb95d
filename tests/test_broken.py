"""Broken study files are refused in one line, at once, and leave nothing behind."""

from __future__ import annotations

from broken_studies import broken_texts, broken_trees, verdict
from hypothesis import HealthCheck, given, settings
from typer.testing import CliRunner

from fosopt.cli.commands import app

_CALM = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example]


@settings(max_examples=300, suppress_health_check=_CALM)
@given(broken_trees())
def test_a_study_with_broken_content_is_an_error_in_one_line_or_none(tree):
    verdict(tree)


@settings(max_examples=50, suppress_health_check=_CALM)
@given(broken_texts())
def test_a_study_with_broken_text_is_an_error_in_one_line_or_none(text):
    verdict(text)


@settings(max_examples=10, suppress_health_check=[*_CALM, HealthCheck.function_scoped_fixture])
@given(broken_texts())
def test_the_command_refuses_what_is_broken_and_leaves_nothing(tmp_path, text):
    if verdict(text) is None:
        return
    file, out = tmp_path / "study.yaml", tmp_path / "run"
    file.write_text(text, encoding="utf-8", errors="surrogatepass", newline="")
    result = CliRunner().invoke(app, ["run", str(file), "--out", str(out)])
    assert (result.exit_code, result.stdout) == (3, "")
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("fosopt: ")
    assert not out.exists()
